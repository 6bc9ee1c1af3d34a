//! Memory of the control step, made once for a library and settings.

use std::sync::Arc;

use egp_parameters::VehicleParameters;

use super::StepError;
use crate::crew::{Alone, Crew};
use crate::linearisation::Linearisation;
use crate::ocp::soft_rows;
use crate::qp::{OcpQp, OcpSolution};
use crate::settings::SettingsError;
use crate::solver::{self, QpSolver, SolverSetupError};
use crate::trajectory::Guess;
use crate::weights::{WeightEstimator, WindowNoise};
use crate::{GpInput, GpOutput, Input, Library, MixtureScratch, Settings, State};

/// Why a workspace could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// Settings out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The QP solver refused its set-up.
    #[error(transparent)]
    Solver(#[from] SolverSetupError),
}

/// Memory for one step at a time; each worker has its own. It carries nothing from one step to the next.
pub struct Workspace {
    library: [u8; 32],
    settings: Settings,
    /// The vehicle to control.
    pub(super) vehicle: VehicleParameters,
    pub(super) noise: WindowNoise,
    pub(super) estimator: WeightEstimator,
    pub(super) previous: Vec<f64>,
    pub(super) active: Vec<f64>,
    pub(super) reference: Vec<State>,
    pub(super) guess: Guess,
    pub(super) dynamics: Linearisation,
    pub(super) qp: OcpQp,
    pub(super) solvers: Vec<Box<dyn QpSolver + Send>>,
    /// Inputs of the last plan, scaled and shifted to now; empty without one.
    pub(super) warm: Vec<Input>,
    pub(super) asked: &'static str,
    pub(super) solution: OcpSolution,
    pub(super) sigma: SigmaMemory,
    pub(super) crew: Arc<dyn Crew>,
}

/// Memory for the standard deviations along the plan.
pub(super) struct SigmaMemory {
    pub queries: Vec<GpInput>,
    pub variances: Vec<GpOutput>,
    pub scratch: MixtureScratch,
}

impl Workspace {
    /// Allocates everything a step needs and sets the QP solver up.
    ///
    /// # Errors
    /// [`SetupError`] for settings out of range, or if the QP solver refuses.
    pub fn new(library: &Library, settings: &Settings) -> Result<Self, SetupError> {
        settings.validate()?;
        let (n, dt) = (library.members().len(), library.dt());
        let horizon = settings.horizon(dt);
        let qp = OcpQp::new(horizon, soft_rows(&settings.soft));
        let solvers = solver::rungs(&qp, &settings.solver)?;
        Ok(Self {
            library: library.id(),
            settings: settings.clone(),
            vehicle: settings.vehicle(library.vehicle()),
            noise: WindowNoise::of(library, &settings.weights),
            estimator: WeightEstimator::new(n, settings.weights.window(dt)),
            previous: vec![0.0; n],
            active: vec![0.0; n],
            reference: vec![State::zeros(); horizon + 1],
            guess: Guess::new(horizon),
            dynamics: Linearisation::new(horizon),
            qp,
            solvers,
            warm: Vec::with_capacity(horizon),
            asked: "",
            solution: OcpSolution::new(horizon),
            sigma: SigmaMemory {
                queries: Vec::with_capacity(horizon),
                variances: vec![GpOutput::zeros(); horizon],
                scratch: MixtureScratch::default(),
            },
            crew: Arc::new(Alone),
        })
    }

    /// Lets members be evaluated at once by `crew`, which may be shared with other workspaces; without one the caller
    /// does everything. The bits of a reply do not depend on it.
    #[must_use]
    pub fn with_crew(mut self, crew: Arc<dyn Crew>) -> Self {
        self.crew = crew;
        self
    }

    /// Name of the QP solver that the last step ended with; empty before the first.
    pub fn solver_name(&self) -> &'static str {
        self.asked
    }

    pub(super) fn belongs_to(
        &self,
        library: &Library,
        settings: &Settings,
    ) -> Result<(), StepError> {
        if self.library == library.id() && self.settings == *settings {
            Ok(())
        } else {
            Err(StepError::Workspace)
        }
    }
}
