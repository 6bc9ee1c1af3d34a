//! What slows a vehicle on a level road beside the forces of its drive and brakes.

/// Rolling resistance and drag of a vehicle, per mass:
///
/// ```text
/// c_0 v_x / max(|v_x|, v_s) + c_2 v_x |v_x|
/// ```
///
/// The rolling resistance `c_0` depends on the road, and the drag `c_2 = rho C_d A / (2 m)` on the vehicle. Rajamani,
/// *Vehicle Dynamics and Control*, 2nd ed., sections 4.1.1 and 4.1.4; below the vehicle's
/// [slip speed](egp_parameters::slip_speed) `v_s` the rolling resistance is proportional to the speed, so that it does not jump
/// where the vehicle stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Resistance {
    /// `c_0`, m/s².
    pub rolling: f64,
    /// `c_2`, 1/m.
    pub drag: f64,
}

impl Resistance {
    /// The deceleration in m/s² at a speed of a vehicle with this slip speed, both in m/s.
    pub(super) fn deceleration(&self, v_x: f64, slip_speed: f64) -> f64 {
        self.rolling * (v_x / slip_speed).clamp(-1.0, 1.0) + self.drag * v_x * v_x.abs()
    }

    /// The derivative of the deceleration by the speed, 1/s.
    pub(super) fn slope(&self, v_x: f64, slip_speed: f64) -> f64 {
        let rolling = if v_x.abs() < slip_speed {
            self.rolling / slip_speed
        } else {
            0.0
        };
        rolling + 2.0 * self.drag * v_x.abs()
    }

    /// The resistance at `share` of the way to another one.
    pub(super) fn between(&self, other: &Self, share: f64) -> Self {
        let blend = |a: f64, b: f64| a + share * (b - a);
        Self {
            rolling: blend(self.rolling, other.rolling),
            drag: blend(self.drag, other.drag),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vehicle::{SINGLE_TRACK_PARAMETERS, SingleTrack};

    /// Slip speed of the vehicle, m/s.
    const SLOWEST: f64 = 3.0;
    const CAR: Resistance = Resistance {
        rolling: 0.15,
        drag: 4e-4,
    };

    #[test]
    fn it_slows_the_vehicle_in_either_direction() {
        assert!((CAR.deceleration(30.0, SLOWEST) - (0.15 + 0.36)).abs() < 1e-12);
        assert_eq!(
            CAR.deceleration(-30.0, SLOWEST),
            -CAR.deceleration(30.0, SLOWEST)
        );
        assert_eq!(CAR.deceleration(0.0, SLOWEST), 0.0);
    }

    #[test]
    fn the_slope_is_that_of_finite_differences() {
        for v_x in [-8.0, -1.0, 0.5, 2.0, 4.0, 40.0] {
            let rise =
                CAR.deceleration(v_x + 1e-6, SLOWEST) - CAR.deceleration(v_x - 1e-6, SLOWEST);
            assert!(
                (rise / 2e-6 - CAR.slope(v_x, SLOWEST)).abs() < 1e-8,
                "{v_x}"
            );
        }
    }

    #[test]
    fn other_friction_leaves_it() {
        let free = SingleTrack::new(&[1.0; SINGLE_TRACK_PARAMETERS], 0.02);
        let car = free.with_resistance(CAR);
        assert_eq!(car.with_friction(0.5).resistance(), CAR);
        assert_eq!(car.between(&free, 0.5).resistance().rolling, 0.075);
    }

    #[test]
    fn between_two_vehicles_it_is_a_linear_blend() {
        let middle = CAR.between(&Resistance::default(), 0.25);
        assert!((middle.rolling - 0.1125).abs() < 1e-15);
        assert!((middle.drag - 3e-4).abs() < 1e-18);
    }
}
