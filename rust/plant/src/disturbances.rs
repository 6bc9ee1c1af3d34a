//! Disturbances that a single-track model of the vehicle does not have.

use serde::Deserialize;

use crate::error::check_range;
use crate::{Parameters, PlantError};

/// Constant disturbances of one vehicle. All are zero by default, and zero has no effect.
///
/// Positions are relative to the unloaded vehicle's centre of mass, x ahead and y to the left.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Disturbances {
    /// Mass of a load on the sprung mass, kg. It is a point at the height of the sprung mass's centre of mass.
    pub load: f64,
    /// Position of the load ahead of the centre of mass, m.
    pub load_x: f64,
    /// Position of the load to the left of the centre of mass, m.
    pub load_y: f64,
    /// Share of peak force and stiffness that the front tyres have lost.
    pub wear_front: f64,
    /// Share of peak force and stiffness that the rear tyres have lost.
    pub wear_rear: f64,
    /// Share of the brake torque that acts on the front axle beyond the vehicle's own share.
    pub brake_bias: f64,
    /// Share of the brake torque of each right wheel that acts on the left wheel instead; negative for the converse.
    pub brake_pull: f64,
    /// Velocity of the air along the map's x axis, m/s.
    pub wind_x: f64,
    /// Velocity of the air along the map's y axis, m/s.
    pub wind_y: f64,
    /// Distance of the wind's lateral force ahead of the centre of mass, m.
    pub wind_arm: f64,
    /// Inclination of the road along the vehicle, rad, positive uphill.
    pub grade: f64,
    /// Inclination of the road across the vehicle, rad, positive if the road rises to the left.
    pub bank: f64,
}

impl Disturbances {
    /// Errors unless every value is within its range. `brake_bias` must leave each axle a share from 0 to 1.
    ///
    /// # Errors
    /// [`PlantError::OutOfRange`] with the first value out of range.
    pub(crate) fn validate(&self, parameters: &Parameters) -> Result<(), PlantError> {
        let [front, rear] = parameters.axles().map(|axle| axle.brake_share);
        for (name, unit, value, low, high) in [
            ("disturbance load", "kg", self.load, 0.0, 1000.0),
            ("disturbance load_x", "m", self.load_x, -3.0, 3.0),
            ("disturbance load_y", "m", self.load_y, -1.0, 1.0),
            ("disturbance wear_front", "of 1", self.wear_front, 0.0, 0.9),
            ("disturbance wear_rear", "of 1", self.wear_rear, 0.0, 0.9),
            (
                "disturbance brake_bias",
                "of 1",
                self.brake_bias,
                -front,
                rear,
            ),
            ("disturbance brake_pull", "of 1", self.brake_pull, -1.0, 1.0),
            ("disturbance wind_x", "m/s", self.wind_x, -60.0, 60.0),
            ("disturbance wind_y", "m/s", self.wind_y, -60.0, 60.0),
            ("disturbance wind_arm", "m", self.wind_arm, -2.0, 2.0),
            ("disturbance grade", "rad", self.grade, -0.5, 0.5),
            ("disturbance bank", "rad", self.bank, -0.7, 0.7),
        ] {
            check_range(name, unit, value, (low, high))?;
        }
        Ok(())
    }
}
