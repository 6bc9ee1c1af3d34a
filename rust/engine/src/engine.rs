//! The adapter between the wire and the mathematics.

use std::{path::Path, sync::Arc};

use egp_core::{
    Library, MOST_FORCE, OcpQp, Settings, StepError, StepReply, StepRequest, VehicleParameters,
    Workspace, library,
};
use egp_wire::{
    Code, Friction, LibraryId, Predictions, Ready, Reply, Request, Status, WireError, limits,
};

use crate::cores::{Cores, available_cores};
use crate::error::EngineError;
use crate::file::read_library;

/// A library and settings, ready to answer requests.
#[derive(Debug)]
pub struct Engine {
    library: Library,
    settings: Settings,
    cores: Option<Arc<Cores>>,
}

/// Memory for one step at a time.
pub struct EngineWorkspace {
    core: Workspace,
    step: StepReply,
    request: Request,
    reply: Reply,
}

impl EngineWorkspace {
    /// The quadratic program of the last step ([`Workspace::problem`]).
    pub fn problem(&self) -> &OcpQp {
        self.core.problem()
    }
}

impl Engine {
    /// Makes an engine after checking that library, settings and wire fit together.
    ///
    /// # Errors
    /// [`EngineError`] if the settings are out of range or do not fit the library's vehicle, or members, horizon, window or forces exceed the limits of the wire.
    pub fn new(library: Library, settings: Settings) -> Result<Self, EngineError> {
        let metadata = library.metadata();
        let settings = settings.complete(
            library.dt(),
            library.least_friction(),
            library.vehicle(),
            metadata.measurement_noise,
            metadata.measurement_delay,
        );
        check_sizes(&library, &settings)?;
        Workspace::new(&library, &settings)?;
        let engine = Self {
            library,
            settings,
            cores: None,
        };
        engine.vehicle().validate()?;
        engine.check_forces()?;
        Ok(engine)
    }

    /// Makes an engine from a library file.
    ///
    /// # Errors
    /// [`EngineError`]; the message names the file.
    pub fn load(path: &Path, settings: Settings) -> Result<Self, EngineError> {
        let bytes = read_library(path).map_err(|source| EngineError::Read {
            path: path.display().to_string(),
            source,
        })?;
        Self::from_bytes(path, &bytes, settings)
    }

    /// Makes an engine from the bytes of a library file.
    ///
    /// # Errors
    /// [`EngineError`]; the message names the file.
    pub fn from_bytes(path: &Path, bytes: &[u8], settings: Settings) -> Result<Self, EngineError> {
        let library = Library::from_bytes(bytes).map_err(|source| EngineError::Library {
            path: path.display().to_string(),
            source,
        })?;
        Self::new(library, settings).map_err(|source| EngineError::Unfit {
            path: path.display().to_string(),
            source: Box::new(source),
        })
    }

    /// Lets steps evaluate members on up to `count` cores, but no more than the machine has, if that saves time and no other
    /// step uses them. The bits of the replies stay the same.
    ///
    /// # Errors
    /// [`EngineError::Threads`].
    pub fn with_cores(mut self, count: usize) -> Result<Self, EngineError> {
        let count = count.min(available_cores());
        self.cores = if count > 1 {
            Some(Cores::new(count)?)
        } else {
            None
        };
        Ok(self)
    }

    /// Shares the cores of another engine, whose steps then count as users of the same cores.
    #[must_use]
    pub fn with_cores_of(mut self, other: &Self) -> Self {
        self.cores.clone_from(&other.cores);
        self
    }

    /// The library.
    pub fn library(&self) -> &Library {
        &self.library
    }

    /// The vehicle that plans are made for: the library's, with the settings' mass and front axle in place of its own. It does
    /// not have the limits and bounds of the settings, which may be narrower than the vehicle's.
    pub fn vehicle(&self) -> VehicleParameters {
        let library = *self.library.vehicle();
        let planned = self.settings.vehicle(&library);
        VehicleParameters {
            mass: planned.mass,
            l_f: planned.l_f,
            ..library
        }
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    fn check_library(&self, request: &Request) -> Result<(), WireError> {
        if request.library == self.library.id() {
            return Ok(());
        }
        Err(unknown_library(&[self.library.id()], &request.library))
    }

    /// Errors if plans, or commands within the limits of the vehicle that [`Engine::describe`] states, may have forces beyond
    /// those of a message. Replies and later requests would be invalid.
    fn check_forces(&self) -> Result<(), EngineError> {
        for vehicle in [
            self.settings.vehicle(self.library.vehicle()),
            self.vehicle(),
        ] {
            let acceleration = vehicle.a_max.max(-vehicle.a_min);
            let force = vehicle.force(acceleration);
            if force > MOST_FORCE {
                return Err(EngineError::Force {
                    force,
                    mass: vehicle.mass,
                    acceleration,
                });
            }
        }
        Ok(())
    }

    /// The properties of the engine that a client needs to make requests.
    pub fn describe(&self) -> Ready {
        // `check_sizes` has compared the numbers with the limits of messages.
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        Ready {
            ready: true,
            library: self.library.id(),
            others: Vec::new(),
            dt: self.library.dt(),
            horizon: count(self.settings.horizon(&self.library)),
            history: count(self.settings.weights.window(&self.library)),
            members: self
                .library
                .members()
                .iter()
                .map(|member| member.label().to_owned())
                .collect(),
            envelope: envelope(&self.library),
            vehicle: Some(self.vehicle()),
            sealed: false, // an engine has no keys of vehicles
        }
    }

    /// Memory for one step at a time.
    ///
    /// # Errors
    /// [`WireError`] with the code `INTERNAL` if the memory cannot be made.
    pub fn workspace(&self) -> Result<EngineWorkspace, WireError> {
        let core = Workspace::new(&self.library, &self.settings)
            .map_err(|error| WireError::permanent(Code::Internal, error.to_string()))?;
        Ok(EngineWorkspace {
            core: match &self.cores {
                Some(cores) => core.with_executor(cores.clone()),
                None => core,
            },
            step: StepReply::default(),
            request: Request::default(),
            reply: Reply::default(),
        })
    }

    /// Decodes a request, computes the step and encodes the reply into `reply`. Returns how the solver ended.
    ///
    /// The reply depends on the request's bytes alone. After a few requests of one shape a step allocates nothing, unless
    /// it runs on several cores.
    ///
    /// # Errors
    /// [`WireError`], which is sent to the client; the content of `reply` is then unspecified.
    pub fn step(
        &self,
        workspace: &mut EngineWorkspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError> {
        let memory = workspace;
        let _core = self.cores.as_ref().map(|cores| cores.occupy());
        memory.request.decode_from(request)?;
        self.check_library(&memory.request)?;
        self.check_members(&memory.request.history_f)?;
        egp_core::step(
            &self.library,
            &self.settings,
            &borrow(&memory.request),
            &mut memory.core,
            &mut memory.step,
        )
        .map_err(|error| refusal(&error))?;
        let solver = memory.core.solver_name();
        self.fill(
            &mut memory.reply,
            memory.request.sequence,
            &memory.step,
            solver,
        );
        memory.reply.encode_to(reply);
        Ok(memory.reply.status)
    }

    /// Errors if a history has predictions of another number of members. The control step sees their values alone, which may be
    /// as many as those of fewer rows with more members.
    fn check_members(&self, predictions: &Predictions) -> Result<(), WireError> {
        let members = self.library.members().len();
        if predictions.is_empty() || predictions.members == members {
            return Ok(());
        }
        let found = predictions.members;
        let detail =
            format!("expected predictions of the library's {members} members, got {found}");
        Err(WireError {
            field: "history_f".to_owned(),
            ..WireError::permanent(Code::InvalidField, detail)
        })
    }

    /// Copies every field of a reply into the memory of this one.
    fn fill(&self, reply: &mut Reply, sequence: u64, step: &StepReply, solver: &str) {
        let Reply {
            library,
            sequence: answered,
            status: ended,
            plan_x,
            plan_u,
            weights,
            sigma,
            history_f,
            dropped_mass,
            iterations,
            kkt_residual,
            solver: name,
            friction,
        } = reply;
        *library = self.library.id();
        *answered = sequence;
        *ended = status(step.status);
        replace(plan_x, step.plan_x.as_chunks().0);
        replace(plan_u, step.plan_u.as_chunks().0);
        replace(weights, &step.weights);
        replace(sigma, step.sigma.as_chunks().0);
        history_f.members = self.library.members().len();
        replace(&mut history_f.values, step.history_f.as_chunks().0);
        *dropped_mass = step.dropped_mass;
        *iterations = step.iterations;
        *kkt_residual = step.kkt_residual;
        name.clear();
        name.push_str(solver);
        let found = &step.friction;
        *friction = Some(Friction {
            mean: found.mean,
            std: found.std,
            lower: found.lower,
            upper: found.upper,
            information: found.information,
            log_likelihood: found.log_likelihood,
            misfit: found.misfit,
        });
    }
}

/// The error for a request that states another library than those that are served. It can be retried, because another replica
/// may serve the library.
pub fn unknown_library(served: &[LibraryId], stated: &LibraryId) -> WireError {
    let served: Vec<_> = served.iter().map(|id| library::hex(id)).collect();
    let detail = format!(
        "this replica serves library {}, the request states {}; ask `ready` what a replica serves",
        served.join(" and "),
        library::hex(stated)
    );
    WireError::retryable(Code::UnknownLibrary, 0, detail)
}

/// Errors if a message cannot carry so many members, inputs of a plan, or transitions.
fn check_sizes(library: &Library, settings: &Settings) -> Result<(), EngineError> {
    let members = library.members().len();
    let horizon = settings.horizon(library);
    let window = settings.weights.window(library);
    for (what, actual, limit) in [
        ("the number of members", members, limits::MEMBERS),
        ("settings.horizon", horizon, limits::HORIZON),
        ("settings.weights.window", window, limits::HISTORY),
    ] {
        if actual > limit {
            return Err(EngineError::Limit {
                what,
                actual,
                limit,
            });
        }
    }
    Ok(())
}

/// Smallest and largest GP input in the training data of all members.
fn envelope(library: &Library) -> [egp_wire::GpInput; 2] {
    let mut members = library.members().iter().map(egp_core::Member::envelope);
    let first = members.next().unwrap_or_default();
    let (low, high) = members.fold(first, |(low, high), (min, max)| {
        (low.inf(&min), high.sup(&max))
    });
    [low.into(), high.into()]
}

fn replace<T: Copy>(out: &mut Vec<T>, values: &[T]) {
    out.clear();
    out.extend_from_slice(values);
}

fn borrow(request: &Request) -> StepRequest<'_> {
    StepRequest {
        x: &request.x,
        u_prev: &request.u_prev,
        weights: &request.weights,
        plan_x: request.plan_x.as_flattened(),
        plan_u: request.plan_u.as_flattened(),
        plan_shift: request.plan_shift,
        history_z: request.history_z.as_flattened(),
        history_y: request.history_y.as_flattened(),
        history_f: request.history_f.values.as_flattened(),
        reference: request.reference.as_flattened(),
        widths: request.widths.as_flattened(),
        road_friction: request.road_friction.as_flattened(),
        want_sigma: request.want_sigma,
    }
}

/// The outcome of a control step as messages state it.
pub fn status(status: egp_core::Status) -> Status {
    match status {
        egp_core::Status::Solved => Status::Solved,
        egp_core::Status::IterationLimit => Status::IterationLimit,
        egp_core::Status::Infeasible => Status::Infeasible,
        egp_core::Status::NumericalError => Status::NumericalError,
        egp_core::Status::CheckFailed => Status::CheckFailed,
    }
}

fn refusal(error: &StepError) -> WireError {
    let field = match error {
        StepError::Shape { field, .. }
        | StepError::Window { field, .. }
        | StepError::NotFinite { field, .. }
        | StepError::Domain { field, .. } => field,
        StepError::Weights { .. } => "weights",
        StepError::Workspace => return WireError::permanent(Code::Internal, error.to_string()),
    };
    WireError {
        field: field.to_owned(),
        ..WireError::permanent(Code::InvalidField, error.to_string())
    }
}
