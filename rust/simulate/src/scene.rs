//! What all runs share: engines and the course.

use std::path::Path as File;
use std::sync::Arc;

use egp_core::Settings;
use egp_engine::{Engine, EngineError};
use egp_path::tracks::RoundedRectangle;
use egp_path::{Path, PathError, SpeedLimits, SpeedProfile, Zone};
use egp_plant::{PlantError, VehicleId};
use egp_wire::WireError;
use thiserror::Error;

use crate::fault::ScheduledFault;

/// The car that is simulated.
pub(crate) const CAR: VehicleId = VehicleId::FordEscort;

/// Why a simulation cannot be made. A violation of an oracle is not an error.
#[derive(Debug, Error)]
pub enum SimulationError {
    /// A library cannot be used.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The course is not valid.
    #[error(transparent)]
    Path(#[from] PathError),
    /// The plant cannot be put on its course.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A worker of a replica cannot be made.
    #[error("cannot make a worker: {0}")]
    Worker(#[from] WireError),
    /// A vehicle's driver cannot be made for the library.
    #[error(transparent)]
    Driver(#[from] egp_driver::DriverError),
    /// A name that the simulation gives is not valid.
    #[error(transparent)]
    Name(#[from] egp_wire::keys::NameError),
    /// The keys of the vehicles cannot be used.
    #[error(transparent)]
    Key(#[from] egp_wire::KeyError),
    /// A scheduled fault is one of a vehicle, a replica or a router that does not take part.
    #[error(
        "{0} is a fault of a vehicle, a replica or a router that the run does not have; see --vehicles, --replicas and \
         --routers"
    )]
    Schedule(ScheduledFault),
    /// A scheduled fault begins after the end of the run.
    #[error("{0} begins after the end of the run, which takes {1} s; see --seconds")]
    Late(ScheduledFault, f64),
    /// The result cannot be written.
    #[error(transparent)]
    Output(#[from] std::io::Error),
    /// A vehicle's measurement is not accepted.
    #[error(transparent)]
    Measurement(#[from] egp_driver::InvalidArgument),
}

/// Engines and course; making one loads and verifies the libraries.
pub struct Scene {
    /// Engines with the library that vehicles ask for, another one, and a part of the other one with as many members as
    /// the first if it has so many.
    pub(crate) engines: [Arc<Engine>; 3],
    pub(crate) path: Path,
    pub(crate) profile: SpeedProfile,
}

impl Scene {
    /// Control period, s.
    pub fn period(&self) -> f64 {
        self.engines[0].library().dt()
    }

    /// Loads the library that vehicles ask for, and another one.
    ///
    /// # Errors
    /// [`SimulationError`] if a file is no library or the course cannot be made.
    pub fn load(library: &File, other: &File) -> Result<Self, SimulationError> {
        let path = RoundedRectangle::default().path()?;
        let path = path.with_friction(&[Zone::new(0.0, 0.9), Zone::new(0.5, 0.6)])?;
        let limits = SpeedLimits {
            grip: 0.6,
            ..SpeedLimits::of(&CAR.vehicle())
        };
        let first = Engine::load(library, Settings::default())?;
        let second = Engine::load(other, Settings::default())?;
        let members = |engine: &Engine| engine.library().members().len();
        let taken: Vec<usize> = (0..members(&first).min(members(&second))).collect();
        let part = |source| EngineError::Library {
            path: other.display().to_string(),
            source,
        };
        let bytes = egp_engine::read_library(other).map_err(|source| EngineError::Read {
            path: other.display().to_string(),
            source,
        })?;
        let bytes = egp_core::library::subset(&bytes, &taken).map_err(part)?;
        let third = Engine::from_bytes(other, &bytes, Settings::default())?;
        Ok(Self {
            engines: [first, second, third].map(Arc::new),
            profile: SpeedProfile::new(&path, &limits)?,
            path,
        })
    }
}
