//! Body, actuator limits and tyres of one vehicle.

use serde::{Deserialize, Serialize};

/// One vehicle: body, actuators and tyres. All values are positive except `a_min`, and within [`VehicleParameters::ranges`].
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

/// A parameter outside the range of road vehicles: in another unit, with the wrong sign, or not finite.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "vehicle parameter `{name}` is {value:?} {unit}: expected {least} to {most}{condition}; check its unit"
)]
pub struct ParameterError {
    /// The field of [`VehicleParameters`].
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The value that came.
    pub value: f64,
    /// The smallest value that is allowed.
    pub least: f64,
    /// The largest value that is allowed.
    pub most: f64,
    /// The fields that the range depends on, or nothing.
    pub condition: &'static str,
}

/// Speed in m/s below which slip angles of full-size vehicles are not defined; see [`slip_speed`].
pub const MIN_SLIP_SPEED: f64 = 3.0;
/// Distance of the axles in m from which on a vehicle is full-size.
pub const FULL_SIZE: f64 = 2.0;

/// The lowest speed, m/s, at which slip angles of a vehicle with this distance of its axles (m) are computed:
/// [`MIN_SLIP_SPEED`] times the square root of the [scale](VehicleParameters::scale).
///
/// Below it the equations of single-track vehicles use this speed in place of `v_x`, and the bound on the slip is left out,
/// because slip angles are not defined at standstill.
pub fn slip_speed(wheelbase: f64) -> f64 {
    MIN_SLIP_SPEED * scale(wheelbase).sqrt()
}

fn scale(wheelbase: f64) -> f64 {
    (wheelbase / FULL_SIZE).min(1.0)
}

/// Smallest and largest yaw inertia, as a multiple of `mass l_f l_r`. For most vehicles the multiple is about 1.
const INERTIAS: (f64, f64) = (0.05, 20.0);

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

    /// Name, smallest and largest value of every field, in the order of the struct: those of model cars to lorries.
    pub const fn ranges() -> [(&'static str, f64, f64); 16] {
        [
            ("mass", 1.0, 1e5),
            ("yaw_inertia", 0.01, 1e7),
            ("l_f", 0.01, 20.0),
            ("l_r", 0.01, 20.0),
            ("width", 0.05, 10.0),
            ("a_min", -50.0, -0.01),
            ("a_max", 0.01, 50.0),
            ("power", 0.5, 5e3),
            ("a_slew", 0.1, 1e5),
            ("steering_angle", 0.01, 1.5),
            ("steering_rate", 0.01, 10.0),
            ("steering_slew", 0.05, 1e5),
            ("peak_slip", 1e-3, 1.5),
            ("lateral_grip", 1e-3, 5.0),
            ("braking_grip", 1e-3, 5.0),
            ("driving_grip", 1e-3, 5.0),
        ]
    }

    /// Checks that every value is within its [range](VehicleParameters::ranges), and that the yaw inertia is 0.05 to 20 times
    /// `mass l_f l_r`. Most values in another unit are outside.
    ///
    /// # Errors
    /// [`ParameterError`] for the first field at fault.
    pub fn validate(&self) -> Result<(), ParameterError> {
        let within = |name, unit, value, (least, most), condition| {
            if (least..=most).contains(&value) {
                return Ok(());
            }
            Err(ParameterError {
                name,
                unit,
                value,
                least,
                most,
                condition,
            })
        };
        for ((name, unit, value), (_, least, most)) in self.fields().into_iter().zip(Self::ranges())
        {
            within(name, unit, value, (least, most), "")?;
        }
        let usual = self.mass * self.l_f * self.l_r;
        within(
            "yaw_inertia",
            "kg m²",
            self.yaw_inertia,
            (INERTIAS.0 * usual, INERTIAS.1 * usual),
            " for this mass and these distances to the axles",
        )
    }

    /// The size of this vehicle relative to a full-size one: `(l_f + l_r) / 2 m`, at most 1.
    ///
    /// On the same surfaces vehicles of similar shape have the same accelerations. Their lengths are proportional to the scale,
    /// times and speeds to its square root, and yaw rates to one over it (Froude's law). Defaults that are lengths, speeds or
    /// weights of such quantities are chosen for full-size vehicles and follow the scale.
    pub fn scale(&self) -> f64 {
        scale(self.l_f + self.l_r)
    }

    /// The [`slip_speed`] of this vehicle, m/s.
    pub fn slip_speed(&self) -> f64 {
        slip_speed(self.l_f + self.l_r)
    }

    /// The product of `a` and the mass: the force in N for an acceleration in m/s², the change of the force in N/s for that of
    /// the acceleration in m/s³, or the power in W for a power per mass in W/kg.
    pub fn force(&self, a: f64) -> f64 {
        a * self.mass
    }
}
