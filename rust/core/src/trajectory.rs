//! The previous plan shifted to the current time, from which the operating trajectory is made.

use crate::vehicle::{DELTA_DOT, FORCE, Frame, P_X, P_Y, PSI};
use crate::{Input, NU, NX, State};

/// The rest of the previous plan in the vehicle's frame.
#[derive(Debug, Clone)]
pub struct Guess {
    /// States from stage 0 to the last stage that the plan contains; empty without a plan.
    pub x: Vec<State>,
    /// Inputs at stages `0..T`, in N and rad/s.
    pub u: Vec<Input>,
}

impl Guess {
    /// An empty guess for a horizon of `horizon` inputs.
    pub fn new(horizon: usize) -> Self {
        Self {
            x: Vec::with_capacity(horizon + 1),
            u: vec![Input::zeros(); horizon],
        }
    }

    /// Shifts a plan made `shift` periods ago to the current time: rows `[7]` of `plan_x`, `[2]` of `plan_u`.
    ///
    /// Stages beyond the end of the plan hold the last force and the steering *angle*; holding the steering *rate* would
    /// keep turning the wheels while plans are missing. Without a plan, or if it ended before now, all inputs are zero.
    pub fn shift(
        &mut self,
        frame: &Frame,
        plan_x: &[[f64; NX]],
        plan_u: &[[f64; NU]],
        shift: usize,
    ) {
        self.x.clear();
        self.u.fill(Input::zeros());
        let (Some(now), Some(last)) = (plan_x.get(shift), plan_u.last()) else {
            return;
        };
        if shift >= plan_u.len() {
            return;
        }
        // The plan's yaw is continuous but may differ from the measured yaw by whole turns.
        let turn = frame.yaw_to_local(now[PSI]) - now[PSI];
        self.x.extend(plan_x[shift..].iter().map(|row| {
            let mut x = State::from_column_slice(row);
            [x[P_X], x[P_Y]] = frame.position_to_local(row[P_X], row[P_Y]);
            x[PSI] = row[PSI] + turn;
            x
        }));
        for (t, u) in self.u.iter_mut().enumerate() {
            *u = plan_u.get(t + shift).map_or_else(
                || Input::new(last[FORCE], 0.0),
                |row| Input::new(row[FORCE], row[DELTA_DOT]),
            );
        }
    }

    /// Takes a plan for the present time, with states in the vehicle's frame and inputs in N and rad/s.
    pub fn take(&mut self, x: &[State], u: impl Iterator<Item = Input>) {
        self.x.clear();
        self.x.extend_from_slice(x);
        for (guessed, planned) in self.u.iter_mut().zip(u) {
            *guessed = planned;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shifted_plan_holds_its_last_input_and_an_expired_plan_is_dropped() {
        let frame = Frame::of(&State::from_column_slice(&[
            10.0, 0.0, 5.0, 6.4, 0.0, 0.0, 0.0,
        ]));
        let plan_x: Vec<[f64; 7]> = (0..5)
            .map(|t| {
                [
                    10.0 + f64::from(t),
                    0.0,
                    5.0,
                    0.1 + 0.01 * f64::from(t),
                    0.0,
                    0.0,
                    0.0,
                ]
            })
            .collect();
        let plan_u: Vec<[f64; 2]> = (0..4).map(|t| [100.0 * f64::from(t), 0.1]).collect();
        let mut guess = Guess::new(4);
        guess.shift(&frame, &plan_x, &plan_u, 2);
        assert_eq!(guess.x.len(), 3);
        assert_eq!(
            guess.u,
            [[200.0, 0.1], [300.0, 0.1], [300.0, 0.0], [300.0, 0.0]].map(Input::from)
        );
        // 0.12 rad on the map is 0.12 - 6.4 + 2 pi in this vehicle's frame.
        assert!((guess.x[0][PSI] - (0.12 - 6.4 + std::f64::consts::TAU)).abs() < 1e-14);
        guess.shift(&frame, &plan_x, &plan_u, 4);
        assert!(guess.x.is_empty() && guess.u.iter().all(|u| *u == Input::zeros()));
    }
}
