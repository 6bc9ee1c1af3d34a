//! Body, actuator limits and tyres of one vehicle.

use serde::{Deserialize, Serialize};

/// One vehicle: body, actuators and tyres. All values are positive except `a_min`.
///
/// Actuator limits are accelerations at the vehicle's own mass, because the optimal control problem is solved in
/// `a = F_x / mass`; [`VehicleParameters::force`] converts them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleParameters {
    /// Mass, kg.
    pub mass: f64,
    /// Moment of inertia about the vertical axis, kg m².
    pub yaw_inertia: f64,
    /// Distance from the centre of mass to the front axle, m.
    pub l_f: f64,
    /// Distance from the centre of mass to the rear axle, m.
    pub l_r: f64,
    /// Width without mirrors, m.
    pub width: f64,
    /// Strongest braking `F_x / mass`, m/s², negative.
    pub a_min: f64,
    /// Strongest drive `F_x / mass`, m/s².
    pub a_max: f64,
    /// Drive power per mass, W/kg: `F_x / mass <= power / v_x`.
    pub power: f64,
    /// Largest change of `F_x / mass` per second, m/s³.
    pub a_slew: f64,
    /// Largest steering angle of the front wheels, rad.
    pub steering_angle: f64,
    /// Largest steering rate, rad/s.
    pub steering_rate: f64,
    /// Largest change of the steering rate per second, rad/s².
    pub steering_slew: f64,
    /// Slip angle at which the front tyres' lateral force peaks on friction 1, rad. Multiplied by the friction, it bounds the
    /// slip on surfaces whose member has no fitted tyres.
    pub peak_slip: f64,
    /// Lateral acceleration that the vehicle reaches on friction `mu`, as a share of `mu g`.
    pub lateral_grip: f64,
    /// Deceleration that the vehicle reaches on friction `mu`, as a share of `mu g`.
    pub braking_grip: f64,
    /// Acceleration that the vehicle reaches on friction `mu`, as a share of `mu g`.
    pub driving_grip: f64,
}

/// A parameter that is not finite, or has the wrong sign.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("vehicle parameter `{name}` must be finite and {sign}, got {value} {unit}")]
pub struct ParameterError {
    /// The field of [`VehicleParameters`].
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The sign it must have.
    pub sign: &'static str,
    /// The value that came.
    pub value: f64,
}

impl VehicleParameters {
    /// Name, unit and value of every field, in the order of the struct.
    pub fn fields(&self) -> [(&'static str, &'static str, f64); 16] {
        [
            ("mass", "kg", self.mass),
            ("yaw_inertia", "kg m²", self.yaw_inertia),
            ("l_f", "m", self.l_f),
            ("l_r", "m", self.l_r),
            ("width", "m", self.width),
            ("a_min", "m/s²", self.a_min),
            ("a_max", "m/s²", self.a_max),
            ("power", "W/kg", self.power),
            ("a_slew", "m/s³", self.a_slew),
            ("steering_angle", "rad", self.steering_angle),
            ("steering_rate", "rad/s", self.steering_rate),
            ("steering_slew", "rad/s²", self.steering_slew),
            ("peak_slip", "rad", self.peak_slip),
            ("lateral_grip", "of mu g", self.lateral_grip),
            ("braking_grip", "of mu g", self.braking_grip),
            ("driving_grip", "of mu g", self.driving_grip),
        ]
    }

    /// Checks that every value is finite and has the sign of its field.
    ///
    /// # Errors
    /// [`ParameterError`] for the first field at fault.
    pub fn validate(&self) -> Result<(), ParameterError> {
        for (name, unit, value) in self.fields() {
            let (sign, allowed) = match name {
                "a_min" => ("negative", value < 0.0),
                _ => ("positive", value > 0.0),
            };
            if !(value.is_finite() && allowed) {
                return Err(ParameterError {
                    name,
                    unit,
                    sign,
                    value,
                });
            }
        }
        Ok(())
    }

    /// The product of `a` and the mass: the force in N for an acceleration in m/s², the change of the force in N/s for that of
    /// the acceleration in m/s³, or the power in W for a power per mass in W/kg.
    pub fn force(&self, a: f64) -> f64 {
        a * self.mass
    }
}
