//! The request of one control step.

use crate::fields::Fields;
use crate::tensor::{Tensor, read_array, read_predictions, read_rows, read_vector};
use crate::writer::Writer;
use crate::{
    FrictionRow, GpInput, GpOutput, Input, Invalid, LibraryId, Predictions, ReferenceRow, State,
    VERSION, WidthRow, check, limits,
};

/// The request of one control step. T is `reference.len() - 1`, N the number of members.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Request {
    /// Library that the vehicle expects.
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
    /// GP inputs `[v_x, v_y, omega, delta, F_x, delta_dot]` of the last transitions, newest first, `[k, 6]`.
    pub history_z: Vec<GpInput>,
    /// Changes of `[v_x, v_y, omega]` over each of those transitions, `[k, 3]`, in m/s, m/s and rad/s.
    pub history_y: Vec<GpOutput>,
    /// The members' predictions of the oldest rows of the history, `[k', N, 3]`, newest of them first.
    pub history_f: Predictions,
    /// `[p_x, p_y, v_x, psi]` for the stages 0..=T, row 0 = now.
    pub reference: Vec<ReferenceRow>,
    /// `[left, right]` for the same stages; empty means no edges.
    pub widths: Vec<WidthRow>,
    /// Whether to compute the predicted standard deviations.
    pub want_sigma: bool,
    /// Rows of friction coefficient and standard deviation, `[T+2, 2]`: first of the road on which the history was measured,
    /// then at the stages 0..=T; empty if nothing is known.
    pub road_friction: Vec<FrictionRow>,
}

impl Request {
    /// Number of inputs in a plan, T.
    pub fn horizon(&self) -> usize {
        self.reference.len().saturating_sub(1)
    }

    /// Bytes of an `egp.v1.StepRequest`; equal requests give equal bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut message = Writer::start(&mut out);
        message.number(1, VERSION.into());
        message.bytes(2, &self.library);
        message.number(3, self.sequence);
        message.number(4, self.budget_us.into());
        message.tensor(5, &[self.x.len()], &self.x);
        message.tensor(6, &[self.u_prev.len()], &self.u_prev);
        message.tensor(7, &[self.weights.len()], &self.weights);
        message.rows(8, &self.plan_x);
        message.rows(9, &self.plan_u);
        message.number(10, self.plan_shift.into());
        message.rows(11, &self.history_z);
        message.rows(12, &self.history_y);
        message.predictions(13, &self.history_f);
        message.rows(14, &self.reference);
        message.rows(15, &self.widths);
        message.number(16, self.want_sigma.into());
        message.rows(17, &self.road_friction);
        out
    }

    /// Reads and validates an `egp.v1.StepRequest`.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        let mut request = Self::default();
        request.decode_from(bytes)?;
        Ok(request)
    }

    /// Like [`decode`](Self::decode), in the memory of a former request; allocates only to grow.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault. The content of the request is then unspecified.
    pub fn decode_from(&mut self, bytes: &[u8]) -> Result<(), Invalid> {
        check::size(bytes, limits::MESSAGE_BYTES)?;
        let raw = Raw::read(bytes)?;
        check::version(raw.version)?;
        let (stages, history) = (limits::HORIZON + 1, limits::HISTORY);
        self.library = check::library(raw.library)?;
        self.sequence = raw.sequence;
        self.budget_us = raw.budget_us;
        self.x = read_array("x", raw.x)?;
        self.u_prev = read_array("u_prev", raw.u_prev)?;
        read_vector("weights", raw.weights, limits::MEMBERS, &mut self.weights)?;
        read_rows("plan_x", raw.plan_x, stages, &mut self.plan_x)?;
        read_rows("plan_u", raw.plan_u, limits::HORIZON, &mut self.plan_u)?;
        self.plan_shift = raw.plan_shift;
        read_rows("history_z", raw.history_z, history, &mut self.history_z)?;
        read_rows("history_y", raw.history_y, history, &mut self.history_y)?;
        read_predictions(
            "history_f",
            raw.history_f,
            history,
            limits::MEMBERS,
            &mut self.history_f,
        )?;
        read_rows("reference", raw.reference, stages, &mut self.reference)?;
        read_rows("widths", raw.widths, stages, &mut self.widths)?;
        self.want_sigma = raw.want_sigma;
        read_rows(
            "road_friction",
            raw.road_friction,
            stages + 1,
            &mut self.road_friction,
        )?;
        self.validate()
    }

    /// Checks the values and how the fields fit together; `decode` has done so already.
    ///
    /// # Errors
    /// [`Invalid::Field`] for the first field at fault.
    pub fn validate(&self) -> Result<(), Invalid> {
        check::budget(self.budget_us)?;
        check_state(&self.x)?;
        check::domain("u_prev", &[self.u_prev], &check::INPUT)?;
        if !(1..=limits::HORIZON).contains(&self.horizon()) {
            return Err(Invalid::field(
                "reference",
                format!(
                    "expected T+1 rows with T from 1 to {}, got {}",
                    limits::HORIZON,
                    self.reference.len()
                ),
            ));
        }
        check_reference(&self.reference, &self.widths)?;
        check_road_friction(&self.road_friction, self.reference.len())?;
        self.validate_plan()?;
        self.validate_history()
    }

    fn validate_plan(&self) -> Result<(), Invalid> {
        check::domain("plan_x", &self.plan_x, &check::STATE)?;
        check::domain("plan_u", &self.plan_u, &check::INPUT)?;
        if self.plan_x.is_empty() && self.plan_u.is_empty() {
            return check::at_most(
                "plan_shift",
                self.plan_shift as usize,
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
            self.plan_shift as usize,
            horizon,
            "the plan has no later row",
        )
    }

    fn validate_history(&self) -> Result<(), Invalid> {
        check::simplex("weights", &self.weights)?;
        check::domain("history_z", &self.history_z, &check::GP_INPUT)?;
        check::domain("history_y", &self.history_y, &check::GP_OUTPUT)?;
        let rows = self.history_z.len();
        if rows > limits::HISTORY {
            return Err(Invalid::field(
                "history_z",
                format!("expected at most {} rows, got {rows}", limits::HISTORY),
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
}

/// Checks a measured state: every component finite and in its domain.
///
/// # Errors
/// [`Invalid::Field`] naming the first component at fault.
pub fn check_state(x: &State) -> Result<(), Invalid> {
    check::domain("x", std::slice::from_ref(x), &check::STATE)
}

/// Checks a reference and its widths: every component in its domain, as many widths as rows or none, and track edges
/// that do not cross.
///
/// # Errors
/// [`Invalid::Field`] naming the first row at fault.
pub fn check_reference(reference: &[ReferenceRow], widths: &[WidthRow]) -> Result<(), Invalid> {
    check::domain("reference", reference, &check::REFERENCE)?;
    check::domain("widths", widths, &check::WIDTHS)?;
    if !widths.is_empty() {
        check::row_count(
            "widths",
            widths.len(),
            reference.len(),
            "as many as in reference, or none",
        )?;
    }
    match widths.iter().position(|[left, right]| left + right < 0.0) {
        Some(row) => Err(Invalid::field(
            "widths",
            format!("row {row}: the edges cross (left + right < 0)"),
        )),
        None => Ok(()),
    }
}

/// Checks what is known about the friction of the road: one row more than the `stages` rows of the reference, or none,
/// of frictions that roads have.
///
/// # Errors
/// [`Invalid::Field`] naming the first row at fault.
pub fn check_road_friction(rows: &[FrictionRow], stages: usize) -> Result<(), Invalid> {
    const FIELD: &str = "road_friction";
    if rows.is_empty() {
        return Ok(());
    }
    check::row_count(
        FIELD,
        rows.len(),
        stages + 1,
        "the road behind and each row of reference, or none",
    )?;
    check::friction(FIELD, rows)
}

/// The fields before they are checked.
#[derive(Default)]
struct Raw<'a> {
    version: u32,
    library: &'a [u8],
    sequence: u64,
    budget_us: u32,
    x: Option<Tensor<'a>>,
    u_prev: Option<Tensor<'a>>,
    weights: Option<Tensor<'a>>,
    plan_x: Option<Tensor<'a>>,
    plan_u: Option<Tensor<'a>>,
    plan_shift: u32,
    history_z: Option<Tensor<'a>>,
    history_y: Option<Tensor<'a>>,
    history_f: Option<Tensor<'a>>,
    reference: Option<Tensor<'a>>,
    widths: Option<Tensor<'a>>,
    want_sigma: bool,
    road_friction: Option<Tensor<'a>>,
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
                4 => raw.budget_us = value.uint32("budget_us")?,
                5 => value.tensor("x", &mut raw.x)?,
                6 => value.tensor("u_prev", &mut raw.u_prev)?,
                7 => value.tensor("weights", &mut raw.weights)?,
                8 => value.tensor("plan_x", &mut raw.plan_x)?,
                9 => value.tensor("plan_u", &mut raw.plan_u)?,
                10 => raw.plan_shift = value.uint32("plan_shift")?,
                11 => value.tensor("history_z", &mut raw.history_z)?,
                12 => value.tensor("history_y", &mut raw.history_y)?,
                13 => value.tensor("history_f", &mut raw.history_f)?,
                14 => value.tensor("reference", &mut raw.reference)?,
                15 => value.tensor("widths", &mut raw.widths)?,
                16 => raw.want_sigma = value.bool("want_sigma")?,
                17 => value.tensor("road_friction", &mut raw.road_friction)?,
                _ => {}
            }
        }
        Ok(raw)
    }
}
