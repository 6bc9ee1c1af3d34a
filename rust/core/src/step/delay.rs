//! Velocities that were measured late: the window with the inputs that caused them, and their present values.

use super::validate::ValidRequest;
use crate::vehicle::{DELTA, OMEGA, STEERING, V_X, V_Y, VELOCITIES};
use crate::{Ensemble, GpInput, GpOutput, NZ, State};

/// Part of a period by which a delay may differ from whole periods by rounding.
const ROUNDING: f64 = 1e-9;

/// The delay `d` of the measured `[v_x, v_y, omega]`: `(periods + part) dt` with `part` in [0, 1).
///
/// Positions, yaw and steering angle are measured without it. A row of the history holds
/// a velocity and the inputs of the time at which the velocity was received. The inputs that caused this velocity are in the
/// rows `periods` and `periods + 1` before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Delay {
    periods: usize,
    part: f64,
}

impl Delay {
    /// The delay of `seconds` at a period of `dt` s; none if it is zero.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // the settings bound it
    pub fn new(seconds: f64, dt: f64) -> Option<Self> {
        let late = seconds / dt;
        // A delay of 0.14 s is seven periods of 0.02 s, although the quotient is larger by rounding.
        let whole = late.round();
        let late = if (late - whole).abs() < ROUNDING {
            whole
        } else {
            late
        };
        let periods = late.floor();
        (seconds > 0.0).then_some(Self {
            periods: periods as usize,
            part: late - periods,
        })
    }

    /// Writes the rows of `history` (newest first) with the steering angle at the time of their velocities, and the
    /// mean inputs over the period after it. Where older rows are missing, the inputs of the oldest one stand in for theirs:
    /// only the first [`Self::known`] rows then have the inputs that caused their changes.
    pub fn align(&self, history: &[[f64; NZ]], out: &mut Vec<[f64; NZ]>) {
        out.clear();
        let at = |i: usize| &history[i.min(history.len() - 1)];
        out.extend((0..history.len()).map(|i| {
            let (newer, older) = (at(i + self.periods), at(i + self.periods + 1));
            let mut row = history[i];
            for column in STEERING..NZ {
                row[column] = self.between(newer[column], older[column]);
            }
            row
        }));
    }

    /// Number of rows of a history whose inputs were applied during the delay.
    pub fn rows(&self) -> usize {
        self.periods + usize::from(self.part > 0.0)
    }

    /// Number of the newest rows of a history of `rows` whose inputs are all in this history.
    pub fn known(&self, rows: usize) -> usize {
        rows.saturating_sub(self.rows())
    }

    /// The measured state with the velocities of now: the ensemble's prediction over the delay, with the inputs that
    /// were applied since, `x(t) = x(t - d) + Σ f(z) h / dt` over parts `h` of at most one period. Without a history the
    /// last input counts as applied since then, and before the oldest row of a history that is shorter than the delay, as
    /// after a reset, the inputs of this row. `disturbance` is added to each change `f`.
    pub fn present(
        &self,
        rows: &ValidRequest,
        ensemble: &Ensemble,
        disturbance: &GpOutput,
    ) -> State {
        let [force, rate] = <[f64; 2]>::from(rows.u_prev);
        let alone = [[0.0, 0.0, 0.0, rows.x[DELTA], force, rate]];
        let history = if rows.history_z.is_empty() {
            &alone
        } else {
            rows.history_z
        };
        let at = |j: usize| &history[j.min(history.len() - 1)];
        let mut x = rows.x;
        let change = |z: &GpInput| ensemble.mean(z) + disturbance;
        // Row j has the steering angle j + 1 periods ago and the inputs from then on.
        let oldest = at(self.periods);
        let after = match self.periods.checked_sub(1) {
            Some(newer) => at(newer)[STEERING],
            None => rows.x[DELTA],
        };
        if self.part > 0.0 {
            let steering = self.between(after, oldest[STEERING]);
            advance(&mut x, steering, oldest, self.part, change);
        }
        for j in (0..self.periods).rev() {
            advance(&mut x, at(j)[STEERING], at(j), 1.0, change);
        }
        x
    }

    /// The value that lies `part` of the way from the newer to the older of two values.
    fn between(&self, newer: f64, older: f64) -> f64 {
        newer + self.part * (older - newer)
    }
}

/// Adds the given part of the velocities' change over a period, at a steering angle and the inputs of `row`.
fn advance(
    x: &mut State,
    steering: f64,
    row: &[f64; NZ],
    part: f64,
    change: impl Fn(&GpInput) -> GpOutput,
) {
    let [.., force, rate] = *row;
    let z = GpInput::new(x[V_X], x[V_Y], x[OMEGA], steering, force, rate);
    let change = change(&z) * part;
    for (state, change) in VELOCITIES.into_iter().zip(change.iter()) {
        x[state] += change;
    }
}
