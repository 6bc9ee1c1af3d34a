//! Vehicle parameters.
//!
//! Values from `commonroad-vehicle-models` 3.0.2 (BSD licence, TUM Cyber-Physical Systems Group), SI units.

mod bmw_320i;
mod ford_escort;

use egp_parameters::VehicleParameters;

use crate::{ActuatorLimits, GRAVITY, PlantError, TyreParameters};

/// The available vehicles of the CommonRoad benchmarks, with their CommonRoad numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VehicleId {
    /// Vehicle 1, front-wheel drive.
    FordEscort = 1,
    /// Vehicle 2, rear-wheel drive.
    Bmw320i = 2,
}

impl VehicleId {
    /// Every vehicle.
    pub const ALL: [Self; 2] = [Self::FordEscort, Self::Bmw320i];

    /// The vehicle's CommonRoad number.
    pub const fn number(self) -> u32 {
        self as u32
    }

    /// The vehicle's parameters.
    pub fn parameters(self) -> Parameters {
        match self {
            Self::FordEscort => ford_escort::PARAMETERS,
            Self::Bmw320i => bmw_320i::PARAMETERS,
        }
    }

    /// The vehicle's parameters for a controller.
    pub fn vehicle(self) -> VehicleParameters {
        match self {
            Self::FordEscort => VehicleParameters::FORD_ESCORT,
            Self::Bmw320i => VehicleParameters::BMW_320I,
        }
    }
}

impl TryFrom<u32> for VehicleId {
    type Error = PlantError;

    fn try_from(number: u32) -> Result<Self, PlantError> {
        Self::ALL
            .into_iter()
            .find(|id| id.number() == number)
            .ok_or(PlantError::UnknownVehicle(number))
    }
}

/// One vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Total mass, kg.
    pub mass: f64,
    /// Yaw inertia of the whole vehicle, kg m².
    pub yaw_inertia: f64,
    /// The mass above the springs.
    pub sprung: SprungMass,
    /// The steered axle.
    pub front: Axle,
    /// The other axle.
    pub rear: Axle,
    /// Parameters of each of the four wheels.
    pub wheel: Wheel,
    /// The compliant pin joint between the sprung mass and each axle.
    pub joint: Joint,
    /// Limits of the actuators.
    pub limits: ActuatorLimits,
    /// Parameters of each of the four tyres.
    pub tyre: TyreParameters,
}

impl Parameters {
    /// The axles, front first.
    pub fn axles(&self) -> [&Axle; 2] {
        [&self.front, &self.rear]
    }

    /// Distance between the axles, m.
    pub fn wheelbase(&self) -> f64 {
        self.front.position - self.rear.position
    }

    /// Static share of the sprung weight on one spring, N, per axle (front first).
    pub fn static_spring_loads(&self) -> [f64; 2] {
        let half_weight = 0.5 * self.sprung.mass * GRAVITY / self.wheelbase();
        [
            -self.rear.position * half_weight,
            self.front.position * half_weight,
        ]
    }

    /// Static load under one wheel, N, per axle (front first).
    pub fn static_wheel_loads(&self) -> [f64; 2] {
        let [front, rear] = self.static_spring_loads();
        [
            front + 0.5 * self.front.unsprung_mass * GRAVITY,
            rear + 0.5 * self.rear.unsprung_mass * GRAVITY,
        ]
    }
}

/// The body above the suspension.
#[derive(Clone, Debug, PartialEq)]
pub struct SprungMass {
    /// Mass, kg.
    pub mass: f64,
    /// Inertia about the longitudinal axis, kg m².
    pub roll_inertia: f64,
    /// Inertia about the lateral axis, kg m².
    pub pitch_inertia: f64,
    /// Product of inertia of roll and yaw, kg m².
    pub roll_yaw_product: f64,
    /// Height of the centre of mass above ground, m.
    pub height: f64,
}

/// One axle with its suspension.
#[derive(Clone, Debug, PartialEq)]
pub struct Axle {
    /// Longitudinal position relative to the centre of mass, m; positive ahead of it.
    pub position: f64,
    /// Distance between the two contact points, m.
    pub track_width: f64,
    /// Mass of axle and wheels below the springs, kg.
    pub unsprung_mass: f64,
    /// Roll inertia of the unsprung mass, kg m².
    pub roll_inertia: f64,
    /// Spring rate per wheel, N/m.
    pub spring: f64,
    /// Damping per wheel, N s/m.
    pub damper: f64,
    /// Auxiliary torsional roll stiffness, N m/rad, negative for an anti-roll bar.
    pub torsion: f64,
    /// Height of the roll axis above ground, m.
    pub roll_axis_height: f64,
    /// Change of camber per suspension travel, rad/m.
    pub camber_gain: f64,
    /// Share of the brake torque on this axle.
    pub brake_share: f64,
    /// Share of the engine torque on this axle.
    pub drive_share: f64,
}

/// One wheel.
#[derive(Clone, Debug, PartialEq)]
pub struct Wheel {
    /// Effective rolling radius, m.
    pub radius: f64,
    /// Inertia about the wheel's axis, kg m².
    pub inertia: f64,
    /// Vertical spring rate of the tyre, N/m.
    pub vertical_stiffness: f64,
    /// Lateral compliance of tyre, wheel and suspension, m/N.
    pub lateral_compliance: f64,
}

/// The lateral pin joint between the sprung mass and an axle.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Stiffness, N/m.
    pub stiffness: f64,
    /// Damping, N s/m.
    pub damping: f64,
}
