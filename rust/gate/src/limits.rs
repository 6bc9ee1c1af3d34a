//! Hard limits of the actuators' values and slew rates.

/// Limits of the commands to the actuators. All values are positive except `force_min`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Vehicle mass \[kg\]; turns the stopping deceleration into a force.
    pub mass: f64,
    /// Strongest braking force \[N\], negative.
    pub force_min: f64,
    /// Strongest driving force \[N\].
    pub force_max: f64,
    /// Motor power \[W\]: the driving force is at most `power / v_x`.
    pub power: f64,
    /// Change of the force per second \[N/s\].
    pub force_slew: f64,
    /// Steering angle \[rad\].
    pub steering_angle: f64,
    /// Steering rate \[rad/s\].
    pub steering_rate: f64,
    /// Change of the steering rate per second \[rad/s²\].
    pub steering_slew: f64,
}

impl Default for Limits {
    /// `CommonRoad` vehicle 1, inside the plant's own limits: -8 to 6 m/s², 54.7 W/kg, 60 m/s³,
    /// 0.91 rad, 0.4 rad/s, 8 rad/s².
    fn default() -> Self {
        let mass = 1225.887;
        Self {
            mass,
            force_min: -8.0 * mass,
            force_max: 6.0 * mass,
            power: 54.7 * mass,
            force_slew: 60.0 * mass,
            steering_angle: 0.91,
            steering_rate: 0.4,
            steering_slew: 8.0,
        }
    }
}

/// A limit that is not finite or has the wrong sign.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("gate limit {name} must be finite and {expected}, got {value}")]
pub struct LimitsError {
    /// The field of [`Limits`] or argument of the gate.
    pub name: &'static str,
    /// The required range.
    pub expected: &'static str,
    /// The given value.
    pub value: f64,
}

/// `value` if it is finite and positive.
pub(crate) fn positive(name: &'static str, value: f64) -> Result<f64, LimitsError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(LimitsError {
            name,
            expected: "positive",
            value,
        })
    }
}

impl Limits {
    /// Checks that all limits are finite and have the right sign.
    ///
    /// # Errors
    /// [`LimitsError`] with the first invalid field.
    pub fn validate(&self) -> Result<(), LimitsError> {
        positive("mass", self.mass)?;
        positive("-force_min", -self.force_min)?;
        positive("force_max", self.force_max)?;
        positive("power", self.power)?;
        positive("force_slew", self.force_slew)?;
        positive("steering_angle", self.steering_angle)?;
        positive("steering_rate", self.steering_rate)?;
        positive("steering_slew", self.steering_slew)?;
        Ok(())
    }

    /// The force nearest to `wanted` that the limits allow at speed `v_x` after `previous`.
    ///
    /// The slew limit takes precedence: if the power limit falls faster than the slew limit allows, the force falls at
    /// full slew. The result lies in `[force_min, force_max]` because `previous` does.
    pub(crate) fn force(&self, wanted: f64, previous: f64, v_x: f64, dt: f64) -> f64 {
        let ceiling = self
            .force_max
            .min(self.power / v_x.abs().max(f64::MIN_POSITIVE));
        let step = self.force_slew * dt;
        wanted
            .clamp(self.force_min, ceiling)
            .clamp(previous - step, previous + step)
            .clamp(self.force_min, self.force_max) // removes the rounding error of the line above
    }

    /// The steering rate nearest to `wanted` that the limits allow at angle `delta` after `previous`.
    ///
    /// From the returned rate, the slew limit can still reduce the rate to zero before the angle exceeds its limit. The
    /// slew limit takes precedence, as for the force.
    pub(crate) fn steering_rate(&self, wanted: f64, previous: f64, delta: f64, dt: f64) -> f64 {
        let step = self.steering_slew * dt;
        let left = self.approach_rate(self.steering_angle - delta, step, dt);
        let right = -self.approach_rate(self.steering_angle + delta, step, dt);
        wanted
            .clamp(right, left)
            .clamp(previous - step, previous + step)
            .clamp(-self.steering_rate, self.steering_rate)
    }

    /// Largest rate towards a limit that is `room` \[rad\] away.
    ///
    /// Slowing from rate `r` by `step` each period turns the wheel by `dt (r + (r - step) + ...) = dt ((n + 1) r - step
    /// n (n + 1) / 2)` with `n = floor(r / step)`. This is solved for `r`, and `n` follows from `room = dt step (n +
    /// 1)(n + 2) / 2`, where `n` changes. Beyond the limit (negative room) the rate points back.
    ///
    /// Room of more than a turn is treated as a turn, so that no measured angle causes an overflow.
    fn approach_rate(&self, room: f64, step: f64, dt: f64) -> f64 {
        let turns = room.min(std::f64::consts::TAU) / dt;
        let rate = if turns > 0.0 {
            let n = (0.5 * ((1.0 + 8.0 * turns / step).sqrt() - 1.0)).floor();
            (turns + 0.5 * step * n * (n + 1.0)) / (n + 1.0)
        } else {
            turns
        };
        rate.clamp(-self.steering_rate, self.steering_rate)
    }
}
