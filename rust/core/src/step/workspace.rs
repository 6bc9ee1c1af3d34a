//! Memory of the control step for one library and settings.

use std::sync::Arc;

use egp_parameters::{MOST_STEERING_ANGLE, VehicleParameters};

use super::StepError;
use super::delay::Delay;
use super::deviations::Deviations;
use super::validate::{MOST_ACCELERATION, MOST_STEERING_RATE};
use crate::executor::{Executor, Sequential};
use crate::friction::FrictionEstimator;
use crate::linearisation::Linearisation;
use crate::ocp::{Caution, soft_rows};
use crate::preview::StageWeights;
use crate::qp::{OcpQp, OcpSolution};
use crate::residual::ResidualFilter;
use crate::settings::SettingsError;
use crate::solver::{self, QpSolver, SolverSetupError};
use crate::trajectory::Guess;
use crate::vehicle::TyreLimits;
use crate::weights::{WeightEstimator, WindowNoise};
use crate::{GpOutput, Input, Library, Member, NZ, Settings, State};

/// A workspace that could not be created.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// Settings out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The QP solver could not be set up.
    #[error(transparent)]
    Solver(#[from] SolverSetupError),
    /// A window that is shorter than the delay of the measured velocities.
    #[error(
        "`weights.window` is {window} periods of {dt} s, shorter than the `measurement_delay` of {delay} s: the present \
         velocities are predicted with the inputs of the window; set `weights.window` to at least {least}, better to twice \
         as many, or `measurement_delay` to a shorter time (without this setting it is the library's)"
    )]
    Window {
        /// Number of transitions of the window.
        window: usize,
        /// The control period, s.
        dt: f64,
        /// The delay, s.
        delay: f64,
        /// Number of transitions whose inputs were applied during the delay.
        least: usize,
    },
    /// A limit of the vehicle beyond what a request may state.
    #[error(
        "{name} of the vehicle to control is {value} {unit}: at most {most} {unit} are supported; check its unit in the \
         settings or in the library"
    )]
    Limit {
        /// The field of [`VehicleParameters`].
        name: &'static str,
        /// Its unit.
        unit: &'static str,
        /// Its magnitude.
        value: f64,
        /// The largest magnitude.
        most: f64,
    },
}

/// Memory for one step at a time; each worker needs its own. No result of a step depends on earlier steps.
pub struct Workspace {
    library: [u8; 32],
    settings: Settings,
    /// The vehicle to control.
    pub(super) vehicle: VehicleParameters,
    /// What the tyres transmit on each member's surface.
    pub(super) tyres: Vec<TyreLimits>,
    /// The delay of the measured velocities, if they have one.
    pub(super) delay: Option<Delay>,
    /// The window's inputs at the time of its velocities.
    pub(super) aligned: Vec<[f64; NZ]>,
    pub(super) noise: WindowNoise,
    pub(super) estimator: WeightEstimator,
    pub(super) friction: FrictionEstimator,
    /// The filter of the residual, if the settings ask for one.
    pub(super) residual: Option<ResidualFilter>,
    /// Disturbance that the residual's filter adds to the ensemble's prediction at each stage; zero without a filter.
    pub(super) offsets: Vec<GpOutput>,
    pub(super) previous: Vec<f64>,
    /// Weights of the active members at each stage.
    pub(super) stages: StageWeights,
    /// Tyre limits at each stage, blended with the weights of the stage.
    pub(super) stage_tyres: Vec<TyreLimits>,
    pub(super) reference: Vec<State>,
    pub(super) guess: Guess,
    pub(super) dynamics: Linearisation,
    pub(super) qp: OcpQp,
    pub(super) solvers: Vec<Box<dyn QpSolver + Send>>,
    /// Inputs of the last plan, scaled and shifted to the current time; empty without a plan.
    pub(super) warm: Vec<Input>,
    pub(super) solver_name: &'static str,
    pub(super) solution: OcpSolution,
    /// The plan about which the last repetition of a step was linearised.
    pub(super) last_solved: OcpSolution,
    pub(super) deviations: Deviations,
    pub(super) caution: Caution,
    pub(super) executor: Arc<dyn Executor>,
}

impl Workspace {
    /// Allocates the memory of a step and sets the QP solver up.
    ///
    /// # Errors
    /// [`SetupError`] if settings are out of range, the window is shorter than the delay of the measured velocities, the
    /// vehicle's limits exceed those that requests may have, or the QP solver cannot be set up.
    pub fn new(library: &Library, settings: &Settings) -> Result<Self, SetupError> {
        settings.validate()?;
        let (n, dt) = (library.members().len(), library.dt());
        let horizon = settings.horizon(library);
        let qp = OcpQp::new(horizon, soft_rows(&settings.soft));
        let solvers = solver::solvers(&qp, &settings.solver)?;
        let vehicle = settings.vehicle(library.vehicle());
        check_limits(&vehicle)?;
        let late = settings.measurement_delay(library.metadata().measurement_delay);
        let delay = Delay::new(late, dt);
        check_window(settings.weights.window(library), dt, late, delay)?;
        let limits = |member: &Member| {
            let limits = member.tyre_limits(&vehicle);
            let stated = settings.soft.slip.map(|slip| slip * member.friction());
            TyreLimits {
                slip: stated.unwrap_or(limits.slip),
                ..limits
            }
        };
        let tyres = library.members().iter().map(limits).collect();
        Ok(Self {
            library: library.id(),
            settings: settings.clone(),
            vehicle,
            tyres,
            delay,
            aligned: Vec::with_capacity(settings.weights.window(library)),
            noise: WindowNoise::of(library, &settings.weights),
            estimator: WeightEstimator::new(n, settings.weights.window(library)),
            friction: FrictionEstimator::new(library, &settings.weights),
            residual: ResidualFilter::new(&settings.residual, dt, settings.weights.window(library)),
            offsets: vec![GpOutput::zeros(); horizon],
            previous: vec![0.0; n],
            stages: StageWeights::new(library.members(), horizon),
            stage_tyres: vec![TyreLimits::default(); horizon + 1],
            reference: vec![State::zeros(); horizon + 1],
            guess: Guess::new(horizon),
            dynamics: Linearisation::new(horizon),
            qp,
            solvers,
            warm: Vec::with_capacity(horizon),
            solver_name: "",
            solution: OcpSolution::new(horizon),
            last_solved: OcpSolution::new(horizon),
            deviations: Deviations::new(horizon),
            caution: Caution::new(horizon),
            executor: Arc::new(Sequential),
        })
    }

    /// Sets the executor that evaluates members, which other workspaces may share. The default is [`Sequential`]. The
    /// bits of a reply do not depend on the executor.
    #[must_use]
    pub fn with_executor(mut self, executor: Arc<dyn Executor>) -> Self {
        self.executor = executor;
        self
    }

    /// Name of the QP solver that ended with the last step's result; empty before the first step.
    pub fn solver_name(&self) -> &'static str {
        self.solver_name
    }

    /// The quadratic program that the last step solved, in the frame of the measured pose. A step that linearises several times
    /// ends with the last one, unless that is not solved.
    pub fn problem(&self) -> &OcpQp {
        &self.qp
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

/// Errors if a full window of `window` transitions does not hold the inputs since the measured velocities, which are `late` s
/// old.
fn check_window(window: usize, dt: f64, late: f64, delay: Option<Delay>) -> Result<(), SetupError> {
    match delay.map(|delay| delay.rows()) {
        Some(least) if window < least => Err(SetupError::Window {
            window,
            dt,
            delay: late,
            least,
        }),
        _ => Ok(()),
    }
}

/// Errors if the vehicle's inputs can leave the domain of requests, so that the next request would be an error.
fn check_limits(vehicle: &VehicleParameters) -> Result<(), SetupError> {
    for (name, unit, value) in vehicle.fields() {
        let most = match name {
            "a_min" | "a_max" => MOST_ACCELERATION,
            "steering_rate" => MOST_STEERING_RATE,
            "steering_angle" => MOST_STEERING_ANGLE,
            _ => f64::INFINITY,
        };
        let value = value.abs();
        if value > most {
            return Err(SetupError::Limit {
                name,
                unit,
                value,
                most,
            });
        }
    }
    Ok(())
}
