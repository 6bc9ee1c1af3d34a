//! The forces of the axles of several single-track vehicles, computed together.

use egp_parameters::GRAVITY;

use crate::kernel::Lanes;
use crate::simd::{Simd, Wide, atan, sin_cos, wide};
use crate::{GpInput, NZ};

/// Number of vehicles in [`Axles`].
pub(super) const VEHICLES: usize = 4;

/// Position, load and tyre parameters of one axle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axle {
    /// Ahead of the centre of mass, m.
    pub position: f64,
    /// 1 where it steers, otherwise 0.
    pub steers: f64,
    /// Load per mass at rest, m/s².
    pub load: f64,
    /// Change of the load with `a_x`.
    pub transfer: f64,
    /// Coupling of the lateral with the longitudinal force under drive and braking, as [`SingleTrack`](super::SingleTrack)
    /// defines `e`; no unit.
    pub coupling: Sides,
    pub friction: f64,
    pub stiffness: f64,
    pub shape: f64,
}

/// A parameter that differs between drive and braking: they act on different axles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sides {
    pub drive: f64,
    pub brake: f64,
}

/// The axles of up to four vehicles side by side: front and rear of the first vehicle, of the second, and so on. All have
/// the same `dt`.
///
/// A vehicle's results are the same bits at every place and beside all other vehicles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axles {
    mass: Lanes,
    slip_speed: Lanes,
    grip: [Lanes; 2],
    position: Lanes,
    steers: Lanes,
    load: Lanes,
    transfer: Lanes,
    coupling: [Lanes; 2],
    friction: Lanes,
    stiffness: Lanes,
    shape: Lanes,
}

/// What the axles depend on beside their parameters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub v_x: f64,
    pub v_y: f64,
    pub omega: f64,
    /// Steering angle in the middle of the period, rad.
    pub steering: f64,
    /// Its sine and cosine.
    pub turned: (f64, f64),
    /// Longitudinal force of all tyres, N.
    pub force: f64,
}

impl Motion {
    /// The motion at the input `z` of a period of `dt` s.
    pub fn new(z: &GpInput, dt: f64) -> Self {
        let [v_x, v_y, omega, delta, force, delta_dot] = <[f64; NZ]>::from(*z);
        let steering = delta + 0.5 * dt * delta_dot;
        Self {
            v_x,
            v_y,
            omega,
            steering,
            turned: steering.sin_cos(),
            force,
        }
    }
}

/// Forces for each axle, per mass of its vehicle, m/s².
#[derive(Clone, Copy, Debug)]
pub(super) struct Forces {
    /// `a_x`, of the vehicle.
    pub longitudinal: Lanes,
    /// Of the axle.
    pub lateral: Lanes,
}

/// Derivatives of [`Forces`]; `a` is the requested acceleration, `F_x / m`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slopes {
    /// Of `a_x` by `a`.
    pub longitudinal: Lanes,
    /// Of the lateral force by `v_x`, `v_y`, the steering angle and `a`.
    pub lateral: [Lanes; 4],
}

impl Axles {
    /// The axles of [`VEHICLES`] vehicles, given with each vehicle's mass, lowest speed of slip angles, and grip.
    pub fn new(of: impl Fn(usize) -> (f64, f64, Sides, [Axle; 2])) -> Self {
        let vehicle = |value: &dyn Fn(f64, f64, Sides) -> f64| {
            std::array::from_fn(|lane| {
                let (mass, slip_speed, grip, _) = of(lane / 2);
                value(mass, slip_speed, grip)
            })
        };
        let each = |value: &dyn Fn(Axle) -> f64| {
            std::array::from_fn(|lane| value(of(lane / 2).3[lane % 2]))
        };
        Self {
            mass: vehicle(&|mass, _, _| mass),
            slip_speed: vehicle(&|_, slip_speed, _| slip_speed),
            grip: [
                vehicle(&|_, _, grip| grip.drive),
                vehicle(&|_, _, grip| grip.brake),
            ],
            position: each(&|axle| axle.position),
            steers: each(&|axle| axle.steers),
            load: each(&|axle| axle.load),
            transfer: each(&|axle| axle.transfer),
            coupling: [
                each(&|axle| axle.coupling.drive),
                each(&|axle| axle.coupling.brake),
            ],
            friction: each(&|axle| axle.friction),
            stiffness: each(&|axle| axle.stiffness),
            shape: each(&|axle| axle.shape),
        }
    }

    /// The forces.
    pub fn forces(&self, motion: &Motion) -> Forces {
        struct Values<'a>(&'a Axles, &'a Motion);
        impl Wide for Values<'_> {
            type Output = Forces;
            #[inline(always)]
            fn compute<S: Simd>(self, simd: S) -> Forces {
                self.0.evaluate(simd, self.1).0
            }
        }
        wide(Values(self, motion))
    }

    /// The forces and their derivatives.
    pub fn forces_and_slopes(&self, motion: &Motion) -> (Forces, Slopes) {
        struct Tangents<'a>(&'a Axles, &'a Motion);
        impl Wide for Tangents<'_> {
            type Output = (Forces, Slopes);
            #[inline(always)]
            fn compute<S: Simd>(self, simd: S) -> (Forces, Slopes) {
                self.0.evaluate(simd, self.1)
            }
        }
        wide(Tangents(self, motion))
    }

    /// The equations of [`SingleTrack`](super::SingleTrack) for each axle.
    #[inline(always)]
    fn evaluate<S: Simd>(&self, simd: S, motion: &Motion) -> (Forces, Slopes) {
        let splat = |x| simd.splat(x);
        let mul = |a, b| simd.mul(a, b);
        let [zero, one] = [0.0, 1.0].map(splat);
        let inverse = |x| simd.div(one, x);
        let fourth_power = |x| mul(mul(x, x), mul(x, x));

        let a = simd.div(splat(motion.force), simd.load(&self.mass));
        let side = |[drive, brake]: &[Lanes; 2]| {
            simd.where_greater(a, zero, simd.load(drive), simd.load(brake))
        };
        let share = simd.div(a, mul(splat(GRAVITY), side(&self.grip)));
        let excess = simd.add(one, fourth_power(share));
        let root = simd.sqrt(simd.sqrt(excess));
        let a_x = simd.div(a, root);
        let a_x_by_a = inverse(mul(excess, root));

        let (v_x, slowest) = (splat(motion.v_x), simd.load(&self.slip_speed));
        let v = simd.where_greater(v_x, slowest, v_x, slowest);
        let [position, stiffness, shape, transfer] =
            [&self.position, &self.stiffness, &self.shape, &self.transfer].map(|x| simd.load(x));
        let across = simd.mul_add(position, splat(motion.omega), splat(motion.v_y));
        let direction = simd.div(across, v);
        let steering = mul(simd.load(&self.steers), splat(motion.steering));
        let slip = mul(stiffness, simd.sub(steering, atan(simd, direction)));
        let (sin, cos) = sin_cos(simd, mul(shape, atan(simd, slip)));
        // The share of the lateral force that drive and braking leave is 1 / sqrt(1 + used⁴).
        let coupling = mul(side(&self.coupling), splat(1.0 / GRAVITY));
        let used = mul(coupling, a);
        let left = inverse(simd.sqrt(simd.add(one, fourth_power(used))));
        let friction = mul(simd.load(&self.friction), left);
        let per_load = mul(friction, sin);
        let load = simd.mul_add(transfer, a_x, simd.load(&self.load));

        let by_slip = simd.div(
            mul(mul(mul(load, friction), cos), mul(shape, stiffness)),
            simd.mul_add(slip, slip, one),
        );
        let turn = mul(simd.mul_add(direction, direction, one), simd.sub(zero, v));
        let by_lateral_speed = simd.div(by_slip, turn);
        let turning = simd.sub(zero, mul(direction, by_lateral_speed));
        let by_speed = simd.where_greater(v_x, slowest, turning, zero);
        // Derivative relative to the lateral force. In this order of the factors no intermediate product overflows.
        let left_by_a = mul(
            mul(mul(mul(used, used), left), mul(used, left)),
            mul(splat(-2.0), coupling),
        );
        let by_a = mul(
            per_load,
            simd.mul_add(transfer, a_x_by_a, mul(load, left_by_a)),
        );
        let by_steering = mul(simd.load(&self.steers), by_slip);
        (
            Forces {
                longitudinal: simd.store(a_x),
                lateral: simd.store(mul(per_load, load)),
            },
            Slopes {
                longitudinal: simd.store(a_x_by_a),
                lateral: [by_speed, by_lateral_speed, by_steering, by_a].map(|x| simd.store(x)),
            },
        )
    }
}
