//! The reply to one control step.

use prost::Message as _;

use crate::{
    GpOutput, Input, Invalid, LibraryId, Limits, State, Status, VERSION, check, proto, tensor,
};

/// The outcome of a control step. Only [`Status::Solved`] carries a plan.
#[derive(Clone, Debug, PartialEq)]
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
    /// Standard deviation of `[v_x, v_y, omega]`, `[T+1]` when asked for.
    pub sigma: Vec<GpOutput>,
    /// The members' predictions of the request's history, `[K][N]`, newest first.
    pub history_f: Vec<Vec<GpOutput>>,
    /// Weight of the members too light to be linearised.
    pub dropped_mass: f64,
    /// Iterations of the QP solver.
    pub iterations: u32,
    /// KKT residual of the solution as checked by the service, scaled.
    pub kkt_residual: f64,
    /// Name of the QP solver.
    pub solver: String,
}

impl Reply {
    /// Bytes of an `egp.v1.StepReply`; equal replies give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        proto::StepReply {
            version: VERSION,
            library: self.library.to_vec(),
            sequence: self.sequence,
            status: self.status.into(),
            plan_x: tensor::rows(&self.plan_x),
            plan_u: tensor::rows(&self.plan_u),
            weights: tensor::vector(&self.weights),
            sigma: tensor::rows(&self.sigma),
            history_f: tensor::blocks(&self.history_f),
            dropped_mass: self.dropped_mass,
            iterations: self.iterations,
            kkt_residual: self.kkt_residual,
            solver: self.solver.clone(),
        }
        .encode_to_vec()
    }

    /// Reads and validates an `egp.v1.StepReply`: a vehicle trusts no service to send sane numbers.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8], limits: &Limits) -> Result<Self, Invalid> {
        check::size(bytes, limits.message_bytes)?;
        let raw = proto::StepReply::decode(bytes)?;
        check::version(raw.version)?;
        let stages = limits.horizon + 1;
        let reply = Self {
            library: check::library(&raw.library)?,
            sequence: raw.sequence,
            status: raw.status(),
            plan_x: tensor::read_rows("plan_x", raw.plan_x.as_ref(), stages)?,
            plan_u: tensor::read_rows("plan_u", raw.plan_u.as_ref(), limits.horizon)?,
            weights: tensor::read_vector("weights", raw.weights.as_ref(), limits.members)?,
            sigma: tensor::read_rows("sigma", raw.sigma.as_ref(), stages)?,
            history_f: tensor::read_blocks(
                "history_f",
                raw.history_f.as_ref(),
                limits.history,
                limits.members,
            )?,
            dropped_mass: raw.dropped_mass,
            iterations: raw.iterations,
            kkt_residual: raw.kkt_residual,
            solver: raw.solver,
        };
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
        check::predictions(&self.history_f, self.history_f.len(), &self.weights)
    }
}
