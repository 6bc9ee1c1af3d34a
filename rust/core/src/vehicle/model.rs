//! The vehicles that a member may contain.

use super::{KINEMATIC_PARAMETERS, Kinematic, Resistance, SINGLE_TRACK_PARAMETERS, SingleTrack};
use crate::{GpInput, GpJacobian, GpOutput};

/// A vehicle that predicts the change of `[v_x, v_y, omega]` over one period.
#[allow(clippy::large_enum_variant)] // few values exist, and a `Box` would cost a pointer access in each prediction
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VehicleModel {
    /// Tyres that slip and saturate.
    SingleTrack(SingleTrack),
    /// Wheels that roll without slip.
    Kinematic(Kinematic),
}

/// The equations of a [`VehicleModel`] and their parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ModelParameters {
    /// In the order of [`SingleTrack::new`].
    SingleTrack([f64; SINGLE_TRACK_PARAMETERS]),
    /// In the order of [`Kinematic::new`].
    Kinematic([f64; KINEMATIC_PARAMETERS]),
}

impl VehicleModel {
    /// A vehicle of positive parameters over periods of `dt` seconds.
    pub fn new(parameters: &ModelParameters, dt: f64) -> Self {
        match parameters {
            ModelParameters::SingleTrack(p) => Self::SingleTrack(SingleTrack::new(p, dt)),
            ModelParameters::Kinematic(p) => Self::Kinematic(Kinematic::new(p, dt)),
        }
    }

    /// The same vehicle with another resistance, if its tyres slip; wheels that roll without slip have none.
    #[must_use]
    pub fn with_resistance(self, resistance: Resistance) -> Self {
        match self {
            Self::SingleTrack(vehicle) => Self::SingleTrack(vehicle.with_resistance(resistance)),
            Self::Kinematic(_) => self,
        }
    }

    /// The same vehicle with `steps >= 1` steps of the Euler method in a period, if its tyres slip; the equations of wheels
    /// that roll without slip need none.
    #[must_use]
    pub fn with_steps(self, steps: u32) -> Self {
        match self {
            Self::SingleTrack(vehicle) => Self::SingleTrack(vehicle.with_steps(steps)),
            Self::Kinematic(_) => self,
        }
    }

    /// The parameters that it was made from.
    pub fn parameters(&self) -> ModelParameters {
        match self {
            Self::SingleTrack(vehicle) => ModelParameters::SingleTrack(*vehicle.parameters()),
            Self::Kinematic(vehicle) => ModelParameters::Kinematic(*vehicle.parameters()),
        }
    }

    /// The change of `[v_x, v_y, omega]` over the period.
    pub fn change(&self, z: &GpInput) -> GpOutput {
        match self {
            Self::SingleTrack(vehicle) => vehicle.change(z),
            Self::Kinematic(vehicle) => vehicle.change(z),
        }
    }

    /// The change and its Jacobian.
    pub fn change_jacobian(&self, z: &GpInput) -> (GpOutput, GpJacobian) {
        match self {
            Self::SingleTrack(vehicle) => vehicle.change_jacobian(z),
            Self::Kinematic(vehicle) => vehicle.change_jacobian(z),
        }
    }
}
