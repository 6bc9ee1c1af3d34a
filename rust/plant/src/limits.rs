//! Limits of steering, engine and brakes.

/// Actuator limits of one vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct ActuatorLimits {
    /// Largest steering angle to either side, rad.
    pub steering_angle: f64,
    /// Largest steering rate to either side, rad/s.
    pub steering_rate: f64,
    /// Largest acceleration and deceleration, m/s².
    pub acceleration: f64,
    /// Speed above which the engine's power limits the acceleration, m/s.
    pub switch_speed: f64,
    /// Speed at or below which there is no deceleration, m/s.
    pub min_speed: f64,
    /// Speed at or above which there is no acceleration, m/s.
    pub max_speed: f64,
}

impl ActuatorLimits {
    /// The actual steering rate for the command `rate` at steering angle `angle`, rad/s.
    ///
    /// The rate is saturated; at a steering stop it is zero in the direction of the stop.
    pub fn steering_rate(&self, angle: f64, rate: f64) -> f64 {
        let at_stop = (angle <= -self.steering_angle && rate <= 0.0)
            || (angle >= self.steering_angle && rate >= 0.0);
        if at_stop {
            0.0
        } else {
            rate.clamp(-self.steering_rate, self.steering_rate)
        }
    }

    /// The actual acceleration for the command `acceleration` at speed `v_x`, m/s².
    ///
    /// `-a_max <= a <= a_max min(1, v_switch / v_x)`; it is zero if it would leave the speed range.
    pub fn acceleration(&self, v_x: f64, acceleration: f64) -> f64 {
        let beyond = (v_x <= self.min_speed && acceleration <= 0.0)
            || (v_x >= self.max_speed && acceleration >= 0.0);
        if beyond {
            return 0.0;
        }
        let driving = if v_x > self.switch_speed {
            self.acceleration * self.switch_speed / v_x
        } else {
            self.acceleration
        };
        acceleration.clamp(-self.acceleration, driving)
    }
}

#[cfg(test)]
mod tests {
    use crate::VehicleId;

    #[test]
    fn commands_saturate_and_are_zero_at_the_ends_of_the_range() {
        let limits = VehicleId::FordEscort.parameters().limits;
        assert_eq!(limits.steering_rate(0.0, 2.0), 0.4);
        assert_eq!(limits.steering_rate(0.0, -2.0), -0.4);
        assert_eq!(limits.steering_rate(0.91, 0.1), 0.0);
        assert_eq!(limits.steering_rate(0.91, -0.1), -0.1);
        assert_eq!(limits.acceleration(1.0, 99.0), 11.5);
        assert_eq!(limits.acceleration(9.51, 99.0), 5.75);
        assert_eq!(limits.acceleration(30.0, -99.0), -11.5);
        assert_eq!(limits.acceleration(45.8, 1.0), 0.0);
        assert_eq!(limits.acceleration(45.8, -1.0), -1.0);
    }
}
