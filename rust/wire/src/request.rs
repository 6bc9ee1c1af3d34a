//! The request of one control step.

use prost::Message as _;

use crate::{
    GpInput, GpOutput, Input, Invalid, LibraryId, Limits, ReferenceRow, State, VERSION, WidthRow,
    check, proto, tensor,
};

/// One control step asked for. T is `reference.len() - 1`, N the number of members.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// Library the vehicle expects.
    pub library: LibraryId,
    /// Increases by one each control period.
    pub sequence: u64,
    /// Time left for the answer, microseconds.
    pub budget_us: u32,
    /// Measured state.
    pub x: State,
    /// Input being applied now.
    pub u_prev: Input,
    /// Weights of the last reply, `[N]` on the simplex; empty means uniform.
    pub weights: Vec<f64>,
    /// States of the last plan, `[T+1]`; empty means a cold start.
    pub plan_x: Vec<State>,
    /// Inputs of the last plan, `[T]`; empty exactly when `plan_x` is.
    pub plan_u: Vec<Input>,
    /// Control periods since that plan's row 0, at most T.
    pub plan_shift: u32,
    /// GP inputs of the last transitions, newest first.
    pub history_z: Vec<GpInput>,
    /// What followed each of them.
    pub history_y: Vec<GpOutput>,
    /// The members' predictions of the oldest rows of the history, `[K'][N]`, newest of them first.
    pub history_f: Vec<Vec<GpOutput>>,
    /// `[p_x, p_y, v_x, psi]` for the stages 0..=T, row 0 = now.
    pub reference: Vec<ReferenceRow>,
    /// `[left, right]` for the same stages; empty means no edges.
    pub widths: Vec<WidthRow>,
    /// Whether to compute the predicted standard deviations.
    pub want_sigma: bool,
}

impl Request {
    /// Number of inputs in a plan, T.
    pub fn horizon(&self) -> usize {
        self.reference.len().saturating_sub(1)
    }

    /// Bytes of an `egp.v1.StepRequest`; equal requests give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        proto::StepRequest {
            version: VERSION,
            library: self.library.to_vec(),
            sequence: self.sequence,
            budget_us: self.budget_us,
            x: tensor::vector(&self.x),
            u_prev: tensor::vector(&self.u_prev),
            weights: tensor::vector(&self.weights),
            plan_x: tensor::rows(&self.plan_x),
            plan_u: tensor::rows(&self.plan_u),
            plan_shift: self.plan_shift,
            history_z: tensor::rows(&self.history_z),
            history_y: tensor::rows(&self.history_y),
            history_f: tensor::blocks(&self.history_f),
            reference: tensor::rows(&self.reference),
            widths: tensor::rows(&self.widths),
            want_sigma: self.want_sigma,
        }
        .encode_to_vec()
    }

    /// Reads and validates an `egp.v1.StepRequest`.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8], limits: &Limits) -> Result<Self, Invalid> {
        check::size(bytes, limits.message_bytes)?;
        let raw = proto::StepRequest::decode(bytes)?;
        check::version(raw.version)?;
        let stages = limits.horizon + 1;
        let request = Self {
            library: check::library(&raw.library)?,
            sequence: raw.sequence,
            budget_us: raw.budget_us,
            x: tensor::read_array("x", raw.x.as_ref())?,
            u_prev: tensor::read_array("u_prev", raw.u_prev.as_ref())?,
            weights: tensor::read_vector("weights", raw.weights.as_ref(), limits.members)?,
            plan_x: tensor::read_rows("plan_x", raw.plan_x.as_ref(), stages)?,
            plan_u: tensor::read_rows("plan_u", raw.plan_u.as_ref(), limits.horizon)?,
            plan_shift: raw.plan_shift,
            history_z: tensor::read_rows("history_z", raw.history_z.as_ref(), limits.history)?,
            history_y: tensor::read_rows("history_y", raw.history_y.as_ref(), limits.history)?,
            history_f: tensor::read_blocks(
                "history_f",
                raw.history_f.as_ref(),
                limits.history,
                limits.members,
            )?,
            reference: tensor::read_rows("reference", raw.reference.as_ref(), stages)?,
            widths: tensor::read_rows("widths", raw.widths.as_ref(), stages)?,
            want_sigma: raw.want_sigma,
        };
        request.validate(limits)?;
        Ok(request)
    }

    /// Checks the values and how the fields fit together; `decode` has done so already.
    ///
    /// # Errors
    /// [`Invalid::Field`] for the first field at fault.
    pub fn validate(&self, limits: &Limits) -> Result<(), Invalid> {
        check::budget(self.budget_us)?;
        check::domain("x", &[self.x], &check::STATE)?;
        check::domain("u_prev", &[self.u_prev], &check::INPUT)?;
        check::domain("reference", &self.reference, &check::REFERENCE)?;
        if !(1..=limits.horizon).contains(&self.horizon()) {
            return Err(Invalid::field(
                "reference",
                format!(
                    "expected T+1 rows with T in 1..={}, got {}",
                    limits.horizon,
                    self.reference.len()
                ),
            ));
        }
        self.validate_plan()?;
        self.validate_history(limits)?;
        self.validate_widths()
    }

    fn validate_plan(&self) -> Result<(), Invalid> {
        check::domain("plan_x", &self.plan_x, &check::STATE)?;
        check::domain("plan_u", &self.plan_u, &check::INPUT)?;
        if self.plan_x.is_empty() && self.plan_u.is_empty() {
            return check::at_most(
                "plan_shift",
                self.plan_shift,
                0,
                "there is no plan to shift",
            );
        }
        let horizon = self.horizon();
        check::row_count(
            "plan_x",
            self.plan_x.len(),
            horizon + 1,
            "as many as in reference",
        )?;
        check::row_count(
            "plan_u",
            self.plan_u.len(),
            horizon,
            "one fewer than in reference",
        )?;
        check::at_most(
            "plan_shift",
            self.plan_shift,
            horizon,
            "the plan has no later row",
        )
    }

    fn validate_history(&self, limits: &Limits) -> Result<(), Invalid> {
        check::simplex("weights", &self.weights)?;
        check::domain("history_z", &self.history_z, &check::GP_INPUT)?;
        check::domain("history_y", &self.history_y, &check::GP_OUTPUT)?;
        let rows = self.history_z.len();
        if rows > limits.history {
            return Err(Invalid::field(
                "history_z",
                format!("expected at most {} rows, got {rows}", limits.history),
            ));
        }
        check::row_count(
            "history_y",
            self.history_y.len(),
            rows,
            "as many as in history_z",
        )?;
        check::predictions(&self.history_f, rows, &self.weights)
    }

    fn validate_widths(&self) -> Result<(), Invalid> {
        check::domain("widths", &self.widths, &check::WIDTHS)?;
        if !self.widths.is_empty() {
            check::row_count(
                "widths",
                self.widths.len(),
                self.reference.len(),
                "as many as in reference, or none",
            )?;
        }
        match self
            .widths
            .iter()
            .position(|[left, right]| left + right < 0.0)
        {
            Some(row) => Err(Invalid::field(
                "widths",
                format!("row {row}: the edges cross (left + right < 0)"),
            )),
            None => Ok(()),
        }
    }
}
