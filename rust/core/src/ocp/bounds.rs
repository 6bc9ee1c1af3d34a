//! Hard bounds that are always feasible, and soft bounds on states and track edges.

use egp_parameters::VehicleParameters;

use crate::qp::{MAX_SOFT, OcpQp, Penalty, SoftRow};
use crate::settings::Soft;
use crate::vehicle::{DELTA, OMEGA, P_X, P_Y, PSI, ROLLING, TyreLimits, V_X, V_Y};
use crate::{Input, NU, State};

/// Share of a slew step by which a bound that cannot be met yet is opened beyond the reachable input, because
/// interior-point methods need an interior.
const INTERIOR: f64 = 0.01;

/// Smallest share of the drive that is left in a bend, so that a vehicle at the end of its grip can hold its speed.
const LEAST_DRIVE: f64 = 0.1;

/// Differences to the reference speed, m/s, between which the share of the drive falls from 1 to [`ROLLING`].
const BEHIND: [f64; 2] = [1.0, 1.5];

/// Number of soft rows for these settings; the rows of the envelope are the last ones.
pub fn soft_rows(soft: &Soft) -> usize {
    if soft.envelope.is_some() {
        MAX_SOFT
    } else {
        MAX_SOFT - 2
    }
}

/// Penalties in the order of the soft rows, for a vehicle of this scale.
pub(super) fn penalties(soft: &Soft, scale: f64) -> [Penalty; MAX_SOFT] {
    let [speed, steering, track, lateral_motion] = soft.penalties(scale);
    [speed, steering, track, lateral_motion, lateral_motion]
}

/// Bounds on inputs and their rates.
///
/// The applied input may lie outside the bounds, after a change of limits or because the drive-power bound fell with
/// rising speed. Each bound is therefore opened, stage by stage, just enough to contain a reachable input. Some input
/// sequence thus satisfies all bounds for every applied input, and the inputs return to the original bounds as fast as
/// the slew limit allows.
///
/// A force that spins or locks the wheels adds no acceleration, and such wheels do not steer. A plan that is linearised where
/// the acceleration has saturated has no reason to avoid it, so the force is bounded by what the tyres transmit.
///
/// In a bend the wheels inside carry less. A differential gives both driven wheels of an axle the same torque, so that more
/// than the inner one can transmit spins it, and a wheel that spins does not steer until it has slowed down, which takes
/// longer than the bend and is no state of the model. The drive is therefore bounded by the share of the load that the wheels
/// inside the bend keep, `1 - transfer |v_x omega|`.
///
/// On slippery surfaces tyres that transmit a lateral force have less left for drive and braking
/// ([`TyreLimits::share_beside`]). The members show little of this: their data contain strong drive and braking for a short time,
/// in which wheels do not yet spin or lock.
///
/// Far below the reference speed, as at a start, the optimum is the largest force, which spins the wheels even on a straight
/// road. The bound on the drive is then reduced to the share [`ROLLING`].
pub(super) fn hard(
    vehicle: &VehicleParameters,
    dt: f64,
    operating: &[State],
    reference: &[State],
    tyres: &[TyreLimits],
    qp: &mut OcpQp,
) {
    let slew = Input::new(vehicle.a_slew * dt, vehicle.steering_slew * dt);
    let (mut low, mut high) = (qp.u_prev, qp.u_prev);
    let road = operating.iter().zip(reference).zip(tyres);
    for (stage, ((x, wanted), tyres)) in qp.stages_mut().iter_mut().zip(road) {
        let inside = 1.0 - tyres.transfer * (x[V_X] * x[OMEGA]).abs();
        let [little, much] = BEHIND;
        let behind = ((wanted[V_X] - x[V_X] - little) / (much - little)).clamp(0.0, 1.0);
        let catching_up = 1.0 - (1.0 - ROLLING) * behind;
        let slip = front_direction(vehicle, x).map_or(0.0, |direction| x[DELTA] - direction);
        let beside = tyres.share_beside(x[V_X] * x[OMEGA], slip);
        let share = inside.max(LEAST_DRIVE).min(catching_up).min(beside);
        let drive = vehicle
            .a_max
            .min(vehicle.power / x[V_X].max(f64::MIN_POSITIVE))
            .min(tyres.drive * share);
        let brake = tyres.brake * tyres.braking.min(beside);
        stage.u_min = Input::new(vehicle.a_min.max(-brake), -vehicle.steering_rate);
        stage.u_max = Input::new(drive, vehicle.steering_rate);
        stage.du_min = -slew;
        stage.du_max = slew;
        for i in 0..NU {
            let (reach_low, reach_high) = (low[i] - slew[i], high[i] + slew[i]);
            stage.u_max[i] = stage.u_max[i].max(reach_low + INTERIOR * slew[i]);
            stage.u_min[i] = stage.u_min[i].min(reach_high - INTERIOR * slew[i]);
            low[i] = stage.u_min[i].max(reach_low);
            high[i] = stage.u_max[i].min(reach_high);
        }
    }
}

/// Soft rows of one stage, in the order of [`crate::qp::SOFT_PATTERN`].
///
/// `operating` and `reference` belong to the stage of the bounded state.
pub(super) fn soft(
    soft: &Soft,
    vehicle: &VehicleParameters,
    slip: f64,
    operating: &State,
    reference: &State,
    widths: Option<&[f64; 2]>,
    rows: &mut [SoftRow; MAX_SOFT],
) {
    let [v_y, omega] = soft.envelope.unwrap_or([1.0; 2]);
    *rows = [
        interval(V_X, 0.0, soft.v_x_max),
        steering(vehicle, slip, operating),
        widths.map_or_else(SoftRow::inactive, |widths| {
            track(reference, widths, soft.edge_margin(vehicle.width))
        }),
        interval(V_Y, -v_y, v_y),
        interval(OMEGA, -omega, omega),
    ];
}

fn interval(state: usize, lower: f64, upper: f64) -> SoftRow {
    SoftRow {
        normal: State::ith(state, 1.0),
        lower,
        upper,
    }
}

/// The steering angles at which the front tyres slip by at most `slip` rad while they move as in the operating state; at
/// very low speed only the largest steering angle is bounded.
///
/// Beyond the peak of the tyres' force more steering gives less force. A controller whose model is linearised there, or
/// predicts the peak at a wrong angle, steers to the limit and loses the remaining force (Beal and Gerdes, *Model
/// Predictive Control for Vehicle Stabilization at the Limits of Handling*, IEEE Transactions on Control Systems
/// Technology 21(4), 2013).
fn steering(vehicle: &VehicleParameters, slip: f64, operating: &State) -> SoftRow {
    let delta = vehicle.steering_angle;
    let Some(direction) = front_direction(vehicle, operating) else {
        return interval(DELTA, -delta, delta);
    };
    let bound = |angle: f64| angle.clamp(-delta, delta);
    interval(DELTA, bound(direction - slip), bound(direction + slip))
}

/// Direction in which the front axle moves, rad from the vehicle's; none at speeds at which slip angles are not defined.
fn front_direction(vehicle: &VehicleParameters, x: &State) -> Option<f64> {
    let sideways = x[V_Y] + vehicle.l_f * x[OMEGA];
    (x[V_X] >= vehicle.slip_speed()).then(|| (sideways / x[V_X]).atan())
}

/// Half the width of the narrowest strip to which a track is bounded, m. On a strip without width both of its bounds are
/// active at once and their multipliers are not unique, so that the solvers miss the tolerance of the check.
pub(super) const NARROWEST: f64 = 0.01;

/// The strip between the track edges, bounded by half-planes normal to the reference yaw. Where the track is narrower
/// than both margins, the strip has the half width [`NARROWEST`] about the centre line between the edges.
fn track(reference: &State, [left, right]: &[f64; 2], margin: f64) -> SoftRow {
    let (sin, cos) = reference[PSI].sin_cos();
    let mut normal = State::zeros();
    normal[P_X] = -sin;
    normal[P_Y] = cos;
    let centre = normal.dot(reference);
    let (lower, upper) = (centre - right + margin, centre + left - margin);
    let middle = 0.5 * (lower + upper);
    SoftRow {
        normal,
        lower: lower.min(middle - NARROWEST),
        upper: upper.max(middle + NARROWEST),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tyres whose longitudinal limits do not depend on the lateral force.
    const TYRES: TyreLimits = TyreLimits {
        friction: 1.0,
        slip: f64::INFINITY,
        drive: 3.0,
        brake: 4.0,
        coupling: [0.0; 2],
        transfer: 0.0,
        lateral: f64::INFINITY,
        braking: 1.0,
    };

    #[test]
    fn a_track_without_room_for_both_margins_is_a_narrow_strip_about_its_centre_line() {
        let reference = State::zeros();
        for margin in [2.0, 3.0, 1e3] {
            let row = track(&reference, &[2.5, 1.5], margin);
            assert!((row.lower - 0.49).abs() < 1e-9, "{margin}: {row:?}");
            assert!((row.upper - 0.51).abs() < 1e-9, "{margin}: {row:?}");
        }
        let row = track(&reference, &[2.5, 1.5], 1.0);
        assert_eq!((row.lower, row.upper), (-0.5, 1.5));
    }

    #[test]
    fn in_a_bend_the_drive_is_bounded_by_the_load_of_the_wheels_inside() {
        let car = VehicleParameters::FORD_ESCORT;
        let tyres = TyreLimits {
            drive: 4.0,
            brake: 9.0,
            transfer: 0.08,
            ..TYRES
        };
        let bounds = |omega: f64| {
            let mut qp = OcpQp::new(1, 3);
            let mut x = State::ith(V_X, 10.0);
            x[OMEGA] = omega;
            hard(&car, 0.1, &[x; 2], &[x; 2], &[tyres; 2], &mut qp);
            (qp.stages()[0].u_max[0], qp.stages()[0].u_min[0])
        };
        // At 10 m/s the lateral acceleration is 10 omega; the inner wheels keep 1 - 0.8 omega of their load.
        assert_eq!(bounds(0.0).0, 4.0);
        assert!((bounds(0.5).0 - 4.0 * 0.6).abs() < 1e-12);
        assert_eq!(bounds(0.5), bounds(-0.5));
        assert_eq!(bounds(2.0).0, 4.0 * LEAST_DRIVE);
        assert_eq!(bounds(0.0).1, bounds(0.5).1);
    }

    #[test]
    fn tyres_that_transmit_a_lateral_force_have_less_left() {
        let car = VehicleParameters::FORD_ESCORT;
        let bounds = |omega: f64, delta: f64, braking: f64| {
            let tyres = TyreLimits {
                friction: 0.3,
                slip: 0.1,
                lateral: 5.0,
                braking,
                ..TYRES
            };
            let mut qp = OcpQp::new(1, 3);
            let mut x = State::ith(V_X, 10.0);
            (x[OMEGA], x[DELTA]) = (omega, delta);
            hard(&car, 0.1, &[x; 2], &[x; 2], &[tyres; 2], &mut qp);
            let stage = &qp.stages()[0];
            [stage.u_max[0] / TYRES.drive, -stage.u_min[0] / TYRES.brake]
        };
        let is = |found: [f64; 2], [drive, brake]: [f64; 2]| {
            (found[0] - drive).abs().max((found[1] - brake).abs()) < 1e-12
        };
        assert_eq!(bounds(0.0, 0.0, 1.0), [1.0; 2]);
        // A lateral acceleration of 3 m/s² of at most 5, without front slip, or a front slip of 0.06 rad of at most 0.1
        // leaves sqrt(1 - 0.6²) = 0.8.
        let rolling = (car.l_f * 0.3 / 10.0).atan();
        assert!(is(bounds(0.3, rolling, 1.0), [0.8; 2]));
        assert!(is(bounds(0.0, -0.06, 1.0), [0.8; 2]));
        // Tyres at their limit keep what lets wheels roll, and of two shares the smaller one counts.
        assert!(is(bounds(0.0, 0.3, 1.0), [ROLLING; 2]));
        assert!(is(bounds(0.0, -0.06, 0.5), [0.8, 0.5]));
    }

    #[test]
    fn a_vehicle_far_below_its_reference_has_less_drive() {
        let car = VehicleParameters::FORD_ESCORT;
        let tyres = TyreLimits {
            drive: 3.0,
            brake: 9.0,
            ..TYRES
        };
        let drive = |behind: f64| {
            let mut qp = OcpQp::new(1, 3);
            let (x, wanted) = (State::ith(V_X, 5.0), State::ith(V_X, 5.0 + behind));
            hard(&car, 0.1, &[x; 2], &[wanted; 2], &[tyres; 2], &mut qp);
            qp.stages()[0].u_max[0]
        };
        assert_eq!((drive(-3.0), drive(1.0)), (3.0, 3.0));
        assert!((drive(1.5) - 1.4).abs() < 1e-12 && drive(9.0) == drive(1.5));
        assert!(drive(1.25) < 3.0 && drive(1.25) > 1.4);
    }

    #[test]
    fn some_input_sequence_meets_all_bounds_for_every_applied_input() {
        let (car, dt) = (VehicleParameters::FORD_ESCORT, 0.05);
        for a in [-40.0, -8.0, 0.0, 5.9, 12.0, 49.0] {
            for rate in [-3.0, 0.0, 0.41, 9.0] {
                let mut qp = OcpQp::new(20, 3);
                qp.u_prev = Input::new(a, rate);
                let operating: Vec<State> = (0..21)
                    .map(|t| State::ith(V_X, 2.0 + 3.0 * f64::from(t)))
                    .collect();
                let tyres = [TyreLimits {
                    drive: 1.0,
                    brake: 2.0,
                    transfer: 0.05,
                    ..TYRES
                }; 21];
                hard(&car, dt, &operating, &operating, &tyres, &mut qp);
                let (mut low, mut high) = (qp.u_prev, qp.u_prev);
                for stage in qp.stages() {
                    for i in 0..NU {
                        low[i] = (low[i] + stage.du_min[i]).max(stage.u_min[i]);
                        high[i] = (high[i] + stage.du_max[i]).min(stage.u_max[i]);
                        assert!(high[i] - low[i] > 1e-4, "{a} {rate}");
                    }
                }
                assert!(
                    high[0] <= car.power / 59.0 + 1e-12,
                    "the drive-power bound holds at the end: {high}"
                );
            }
        }
    }

    #[test]
    fn the_front_slip_angle_is_bounded() {
        let car = VehicleParameters {
            l_f: 1.0,
            ..VehicleParameters::FORD_ESCORT
        };
        let mut x = State::zeros();
        (x[V_X], x[V_Y], x[OMEGA]) = (20.0, -6.0, 1.0);
        let row = steering(&car, 0.1, &x);
        let direction = (-0.25_f64).atan();
        assert_eq!(row.normal, State::ith(DELTA, 1.0));
        assert!((row.lower - (direction - 0.1)).abs() < 1e-15);
        assert!((row.upper - (direction + 0.1)).abs() < 1e-15);
        // At parking speed the full steering angle is allowed.
        let mut parking = State::zeros();
        (parking[V_X], parking[OMEGA]) = (1.0, 0.3);
        assert_eq!(steering(&car, 0.1, &parking).upper, car.steering_angle);
        // In a slide the bound on slip exceeds the largest steering angle.
        x[V_Y] = 60.0;
        let row = steering(&car, 0.1, &x);
        assert!(row.lower == car.steering_angle && row.upper == car.steering_angle);
    }

    #[test]
    fn the_strip_lies_left_and_right_of_the_reference() {
        let mut reference = State::zeros();
        (reference[P_X], reference[P_Y], reference[PSI]) = (3.0, 1.0, std::f64::consts::FRAC_PI_2);
        let row = track(&reference, &[4.0, 2.0], 0.5);
        // Looking along +y, left is -x: x between 3 - 3.5 and 3 + 1.5.
        let at = |x: f64| row.normal[P_X] * x + row.normal[P_Y] * 1.0;
        assert!((at(-0.5) - row.upper).abs() < 1e-12 && (at(4.5) - row.lower).abs() < 1e-12);
        let narrow = track(&reference, &[0.2, 0.4], 0.5);
        for (bound, expected) in [(narrow.lower, -NARROWEST), (narrow.upper, NARROWEST)] {
            assert!((bound - at(3.1) - expected).abs() < 1e-12, "{narrow:?}");
        }
    }
}
