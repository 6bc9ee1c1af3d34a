//! The reply to one control step.

use crate::error::printable;
use crate::fields::{Fields, once};
use crate::friction::Friction;
use crate::tensor::{Tensor, read_predictions, read_rows, read_vector};
use crate::writer::Writer;
use crate::{
    GpOutput, Input, Invalid, LibraryId, Predictions, State, Status, VERSION, check, limits,
};

/// The status in lower case without its prefix, for example `iteration_limit`, as metrics, logs and programs show it.
pub fn status_name(status: Status) -> &'static str {
    match status {
        Status::Unspecified => "unspecified",
        Status::Solved => "solved",
        Status::IterationLimit => "iteration_limit",
        Status::Infeasible => "infeasible",
        Status::NumericalError => "numerical_error",
        Status::CheckFailed => "check_failed",
    }
}

/// The outcome of a control step. Only one with [`Status::Solved`] has a plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reply {
    /// Library that answered.
    pub library: LibraryId,
    /// Sequence number of the request.
    pub sequence: u64,
    /// How the solver ended.
    pub status: Status,
    /// Planned states, `[T+1]`, row 0 = the measured state.
    pub plan_x: Vec<State>,
    /// Planned inputs, `[T]`.
    pub plan_u: Vec<Input>,
    /// Adapted weights, `[N]`.
    pub weights: Vec<f64>,
    /// Standard deviation of `[v_x, v_y, omega]`, `[T+1]` if requested.
    pub sigma: Vec<GpOutput>,
    /// The members' predictions of the request's history, `[k, N, 3]`, newest first.
    pub history_f: Predictions,
    /// Sum of the weights of members that are not in the control model: weights up to `weights.threshold`, and those beyond
    /// the `weights.max_active` largest.
    pub dropped_mass: f64,
    /// Iterations of the QP solver.
    pub iterations: u32,
    /// KKT residual of the solution as checked by the service, scaled.
    pub kkt_residual: f64,
    /// Name of the QP solver.
    pub solver: String,
    /// Friction that the transitions indicate; absent from older services.
    pub friction: Option<Friction>,
}

impl Reply {
    /// Bytes of an `egp.v1.StepReply`; equal replies give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        self.encode_to(&mut out);
        out
    }

    /// Like [`encode`](Self::encode), but replaces the content of `out`; allocates only to grow.
    pub fn encode_to(&self, out: &mut Vec<u8>) {
        let mut message = Writer::start(out);
        message.number(1, VERSION.into());
        message.bytes(2, &self.library);
        message.number(3, self.sequence);
        message.number(4, self.status as u64);
        message.rows(5, &self.plan_x);
        message.rows(6, &self.plan_u);
        message.tensor(7, &[self.weights.len()], &self.weights);
        message.rows(8, &self.sigma);
        message.predictions(9, &self.history_f);
        message.double(10, self.dropped_mass);
        message.number(11, self.iterations.into());
        message.double(12, self.kkt_residual);
        message.bytes(13, self.solver.as_bytes());
        if let Some(friction) = &self.friction {
            message.doubles(
                14,
                &friction.values(),
                &friction.log_likelihood,
                friction.misfit,
            );
        }
    }

    /// Reads and validates an `egp.v1.StepReply`. A vehicle checks every number, because a service may be faulty.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        check::size(bytes, limits::MESSAGE_BYTES)?;
        let raw = Raw::read(bytes)?;
        check::version(raw.version)?;
        let stages = limits::HORIZON + 1;
        let mut reply = Self {
            library: check::library(raw.library)?,
            sequence: raw.sequence,
            status: Status::try_from(raw.status.cast_signed()).unwrap_or_default(),
            dropped_mass: raw.dropped_mass,
            iterations: raw.iterations,
            kkt_residual: raw.kkt_residual,
            solver: printable(raw.solver),
            friction: raw.friction.map(Friction::read).transpose()?,
            ..Self::default()
        };
        read_rows("plan_x", raw.plan_x, stages, &mut reply.plan_x)?;
        read_rows("plan_u", raw.plan_u, limits::HORIZON, &mut reply.plan_u)?;
        read_vector("weights", raw.weights, limits::MEMBERS, &mut reply.weights)?;
        read_rows("sigma", raw.sigma, stages, &mut reply.sigma)?;
        read_predictions(
            "history_f",
            raw.history_f,
            limits::HISTORY,
            limits::MEMBERS,
            &mut reply.history_f,
        )?;
        reply.validate()?;
        Ok(reply)
    }

    fn validate(&self) -> Result<(), Invalid> {
        match self.status {
            Status::Unspecified => {
                return Err(Invalid::field(
                    "status",
                    "is absent or not known to this side",
                ));
            }
            Status::Solved if self.plan_u.is_empty() => {
                return Err(Invalid::field(
                    "plan_u",
                    "is absent although the status is solved",
                ));
            }
            Status::Solved => {
                let stages = self.plan_u.len() + 1;
                check::row_count(
                    "plan_x",
                    self.plan_x.len(),
                    stages,
                    "one more than in plan_u",
                )?;
            }
            _ if !self.plan_u.is_empty() || !self.plan_x.is_empty() => {
                return Err(Invalid::field(
                    "plan_u",
                    "is present although nothing was solved",
                ));
            }
            _ => {}
        }
        check::domain("plan_x", &self.plan_x, &check::STATE)?;
        check::domain("plan_u", &self.plan_u, &check::INPUT)?;
        if self.weights.is_empty() {
            return Err(Invalid::field("weights", "is required and absent"));
        }
        check::simplex("weights", &self.weights)?;
        check::deviations("sigma", &self.sigma)?;
        check::share("dropped_mass", self.dropped_mass)?;
        let solved = self.status == Status::Solved;
        check::residual("kkt_residual", self.kkt_residual, solved)?;
        check::predictions(&self.history_f, self.history_f.len(), &self.weights)
    }
}

/// The fields before they are checked.
#[derive(Default)]
struct Raw<'a> {
    version: u32,
    library: &'a [u8],
    sequence: u64,
    status: u32,
    plan_x: Option<Tensor<'a>>,
    plan_u: Option<Tensor<'a>>,
    weights: Option<Tensor<'a>>,
    sigma: Option<Tensor<'a>>,
    history_f: Option<Tensor<'a>>,
    dropped_mass: f64,
    iterations: u32,
    kkt_residual: f64,
    solver: &'a str,
    friction: Option<&'a [u8]>,
}

impl<'a> Raw<'a> {
    fn read(message: &'a [u8]) -> Result<Self, Invalid> {
        let mut raw = Self::default();
        for field in Fields::of(message) {
            let (tag, value) = field?;
            match tag {
                1 => raw.version = value.uint32("version")?,
                2 => raw.library = value.bytes("library")?,
                3 => raw.sequence = value.uint64("sequence")?,
                4 => raw.status = value.uint32("status")?,
                5 => value.tensor("plan_x", &mut raw.plan_x)?,
                6 => value.tensor("plan_u", &mut raw.plan_u)?,
                7 => value.tensor("weights", &mut raw.weights)?,
                8 => value.tensor("sigma", &mut raw.sigma)?,
                9 => value.tensor("history_f", &mut raw.history_f)?,
                10 => raw.dropped_mass = value.double("dropped_mass")?,
                11 => raw.iterations = value.uint32("iterations")?,
                12 => raw.kkt_residual = value.double("kkt_residual")?,
                13 => raw.solver = value.text("solver")?,
                14 => once("friction", &mut raw.friction, value.bytes("friction")?)?,
                _ => {}
            }
        }
        Ok(raw)
    }
}
