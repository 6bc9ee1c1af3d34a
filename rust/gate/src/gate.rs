//! The gate: WAITING → NORMAL → TAIL → STOP.

use std::ops::RangeInclusive;

use crate::limits::{Limits, LimitsError, ROUNDING, positive};

/// Largest number of inputs of a plan.
pub const MAX_HORIZON: usize = 128;

/// Accepted control periods \[s\]. With much smaller or larger ones, differences of rates overflow or vanish.
const PERIODS: RangeInclusive<f64> = 1e-4..=10.0;

/// How long the rest of a plan may be used by default \[s\].
const TAIL: f64 = 0.5;

/// Below this speed \[m/s\] the stopping force decreases linearly to zero, so that a stop ends in standstill.
const HOLD_SPEED: f64 = 0.5;

/// Source of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The first input of a plan made for this period.
    Normal,
    /// A later input of an older plan, because no new plan arrived in time.
    Tail,
    /// Braking with the steering held, latched until [`Gate::reset`].
    Stop,
    /// Braking with the steering held because no plan has been driven since the start or the last [`Gate::reset`]; the
    /// first plan that has an input for its period ends it.
    Waiting,
}

impl Mode {
    /// Its name in messages, recordings and Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::Tail => "tail",
            Self::Stop => "stop",
            Self::Waiting => "waiting",
        }
    }
}

/// Command to the actuators.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Force \[N\] and steering rate \[rad/s\], always finite and inside the limits.
    pub u: [f64; 2],
    /// Source of the command.
    pub mode: Mode,
    /// Whether a limit changed the planned or stopping input.
    pub limited: bool,
}

/// An invalid plan or configuration. The state of the gate is then unchanged.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GateError {
    /// An invalid limit or setting.
    #[error(transparent)]
    Limits(#[from] LimitsError),
    /// A stop that needs more force than the limits allow.
    #[error(
        "gate setting stop_deceleration is {value} m/s², the limits allow at most -force_min / mass = {bound} m/s²; \
         state at most this, or leave it out"
    )]
    StopDeceleration {
        /// The given value.
        value: f64,
        /// The strongest deceleration of the limits.
        bound: f64,
    },
    /// A control period that is out of range.
    #[error("the control period is {0} s, the gate needs one from 0.0001 s to 10 s")]
    Period(f64),
    /// A plan without inputs, or with more than [`MAX_HORIZON`].
    #[error("a plan has 1 to {MAX_HORIZON} inputs, got {0}")]
    Length(usize),
    /// An input of the plan is NaN or infinite.
    #[error("input {0} of the plan is not finite")]
    NotFinite(usize),
    /// The plan starts before the stored plan.
    #[error("the plan starts at tick {got}, before the stored plan (tick {held})")]
    Stale {
        /// First tick of the stored plan.
        held: u64,
        /// First tick of the rejected plan.
        got: u64,
    },
    /// The gate has stopped the vehicle.
    #[error("the gate has stopped the vehicle; call reset() when it is safe to continue")]
    Stopped,
}

/// Stores the newest plan and derives the commands from it. See the crate's documentation for an example.
#[derive(Clone, Debug)]
pub struct Gate {
    limits: Limits,
    dt: f64,
    max_tail_ticks: u64,
    stop_force: f64,
    plan: [[f64; 2]; MAX_HORIZON],
    /// Number of stored inputs, zero before the first plan, and tick of the first input.
    length: usize,
    start: u64,
    mode: Mode,
    previous: [f64; 2],
    /// The last finite steering angle.
    delta: f64,
}

impl Gate {
    /// Number of periods of `dt` \[s\] that the rest of a plan may bridge by default: half a second, rounded to whole
    /// periods, and at least one period.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at least 1, and at most 5000 for a valid period
    pub fn default_tail_ticks(dt: f64) -> u64 {
        (TAIL / dt).round().max(1.0) as u64
    }

    /// A gate with periods of `dt` \[s\], from 1e-4 to 10. After `max_tail_ticks` periods without a new plan it brakes with
    /// `stop_deceleration` \[m/s²\].
    ///
    /// # Errors
    /// [`GateError::Limits`] if a value is not finite or has the wrong sign, [`GateError::Period`] if `dt` is out of range, and
    /// [`GateError::StopDeceleration`] if the stop needs more force than the limits allow.
    pub fn new(
        limits: Limits,
        dt: f64,
        max_tail_ticks: u64,
        stop_deceleration: f64,
    ) -> Result<Self, GateError> {
        limits.validate()?;
        if !(PERIODS.contains(&dt)) {
            return Err(GateError::Period(dt));
        }
        let stop_force = limits.mass * positive("stop_deceleration", stop_deceleration)?;
        if stop_force > -limits.force_min * (1.0 + ROUNDING) {
            return Err(GateError::StopDeceleration {
                value: stop_deceleration,
                bound: -limits.force_min / limits.mass,
            });
        }
        Ok(Self {
            limits,
            dt,
            max_tail_ticks,
            stop_force: stop_force.min(-limits.force_min),
            plan: [[0.0; 2]; MAX_HORIZON],
            length: 0,
            start: 0,
            mode: Mode::Waiting,
            previous: [0.0; 2],
            delta: 0.0,
        })
    }

    /// Stores a plan whose first input is meant for period `tick`.
    ///
    /// # Errors
    /// [`GateError`] if the plan is empty, too long, not finite or starts before the stored plan, or if the gate is in
    /// STOP. The stored plan is then kept.
    pub fn accept(&mut self, tick: u64, plan_u: &[[f64; 2]]) -> Result<(), GateError> {
        if self.mode == Mode::Stop {
            return Err(GateError::Stopped);
        }
        if plan_u.is_empty() || plan_u.len() > MAX_HORIZON {
            return Err(GateError::Length(plan_u.len()));
        }
        if let Some(stage) = plan_u
            .iter()
            .position(|u| !(u[0].is_finite() && u[1].is_finite()))
        {
            return Err(GateError::NotFinite(stage));
        }
        if self.length > 0 && tick < self.start {
            return Err(GateError::Stale {
                held: self.start,
                got: tick,
            });
        }
        for (held, new) in self.plan.iter_mut().zip(plan_u) {
            *held = *new;
        }
        (self.length, self.start) = (plan_u.len(), tick);
        Ok(())
    }

    /// The command for period `tick` from the measured speed \[m/s\] and steering angle \[rad\]. The gate changes to
    /// STOP if a measurement is not finite, or if the plan that was driven has no input for this period. A first plan that
    /// comes too late to have one leaves the gate waiting. As long as the speed is not finite, a stop brakes with its whole
    /// force: an earlier speed says nothing about the present one.
    pub fn command(&mut self, tick: u64, v_x: f64, delta: f64) -> Command {
        let measured = v_x.is_finite() && delta.is_finite();
        // An infinite speed allows braking but no driving force.
        let v_x = if v_x.is_finite() { v_x } else { f64::INFINITY };
        if delta.is_finite() {
            self.delta = delta;
        }
        let planned = if measured && self.mode != Mode::Stop {
            self.planned(tick)
        } else {
            None
        };
        let wanted = if let Some((mode, u)) = planned {
            self.mode = mode;
            u
        } else {
            // Without a plan that was driven there is nothing to stop: the vehicle is braked until the first one comes.
            let waiting = measured && self.mode == Mode::Waiting;
            self.mode = if waiting { Mode::Waiting } else { Mode::Stop };
            // The steering angle is held, which keeps the curvature of the last plan. Straight wheels would leave the
            // road in a bend.
            [-self.stop_force * (v_x / HOLD_SPEED).clamp(-1.0, 1.0), 0.0]
        };
        let [force, rate] = self.previous;
        let u = [
            self.limits.force(wanted[0], force, v_x, self.dt),
            self.limits
                .steering_rate(wanted[1], rate, self.delta, self.dt),
        ];
        self.previous = u;
        Command {
            u,
            mode: self.mode,
            limited: u != wanted,
        }
    }

    /// Leaves STOP and discards the plan: the vehicle is braked until a new plan is accepted. The slew limits still
    /// apply relative to the last command.
    pub fn reset(&mut self) {
        self.mode = Mode::Waiting;
        self.length = 0;
    }

    /// Stops the vehicle from the next [`Gate::command`] on, whatever plan is held.
    pub fn stop(&mut self) {
        self.mode = Mode::Stop;
    }

    /// Source of the last command.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The input of the stored plan for `tick`, if it exists and the tail may last that long.
    fn planned(&self, tick: u64) -> Option<(Mode, [f64; 2])> {
        let age = tick
            .checked_sub(self.start)
            .filter(|age| *age <= self.max_tail_ticks)?;
        let u = self
            .plan
            .get(..self.length)?
            .get(usize::try_from(age).ok()?)?;
        Some((if age == 0 { Mode::Normal } else { Mode::Tail }, *u))
    }
}
