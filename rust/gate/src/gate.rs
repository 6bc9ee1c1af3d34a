//! The gate: WAITING → NORMAL → TAIL → STOP.

use crate::limits::{Limits, LimitsError, positive};

/// Longest plan the gate can hold, in periods.
pub const MAX_HORIZON: usize = 128;

/// Below this speed \[m/s\] the stopping force fades to zero, so that a stop ends in standstill.
const HOLD_SPEED: f64 = 0.5;

/// Where the command comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// The first input of a plan made for this period.
    Normal,
    /// A later input of an older plan: no new one came in time.
    Tail,
    /// Braking with the steering held, latched until [`Gate::reset`].
    Stop,
    /// Braking with the steering held because no plan has come since the start or the last [`Gate::reset`]; the first
    /// plan ends it.
    Waiting,
}

/// What leaves the gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Force \[N\] and steering rate \[rad/s\], always finite and inside the limits.
    pub u: [f64; 2],
    /// Where it comes from.
    pub mode: Mode,
    /// Whether a limit changed what the plan asked for.
    pub limited: bool,
}

/// Why a plan or a configuration was refused. The gate's state is then unchanged.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GateError {
    /// A limit or setting that cannot be.
    #[error(transparent)]
    Limits(#[from] LimitsError),
    /// No inputs, or more than [`MAX_HORIZON`].
    #[error("a plan has 1 to {MAX_HORIZON} inputs, got {0}")]
    Length(usize),
    /// NaN or infinity in the plan.
    #[error("input {0} of the plan is not finite")]
    NotFinite(usize),
    /// The plan starts before the one already held.
    #[error("the plan starts at tick {got}, older than the one held (tick {held})")]
    Stale {
        /// First tick of the plan held.
        held: u64,
        /// First tick of the plan refused.
        got: u64,
    },
    /// The gate has stopped the vehicle.
    #[error("the gate has stopped the vehicle; call reset() once it is safe to drive on")]
    Stopped,
}

/// Holds the newest plan and decides what leaves. See the crate's documentation for an example.
#[derive(Clone, Debug)]
pub struct Gate {
    limits: Limits,
    dt: f64,
    max_tail_ticks: u64,
    stop_force: f64,
    plan: [[f64; 2]; MAX_HORIZON],
    /// Inputs held, zero before the first plan, and the tick of the first one.
    length: usize,
    start: u64,
    mode: Mode,
    previous: [f64; 2],
    /// Last finite measurement. An unknown speed counts as fast: brake, no driving force.
    v_x: f64,
    delta: f64,
}

impl Gate {
    /// A gate with periods of `dt` \[s\] that bridges at most `max_tail_ticks` periods without a new
    /// plan and then brakes with `stop_deceleration` \[m/s²\].
    ///
    /// # Errors
    /// [`GateError::Limits`] when a value is not finite or has the wrong sign, or when the stopping
    /// force would lie outside the limits.
    pub fn new(
        limits: Limits,
        dt: f64,
        max_tail_ticks: u64,
        stop_deceleration: f64,
    ) -> Result<Self, GateError> {
        limits.validate()?;
        let stop_force = limits.mass * positive("stop_deceleration", stop_deceleration)?;
        if stop_force > -limits.force_min {
            return Err(GateError::Limits(LimitsError {
                name: "stop_deceleration",
                expected: "at most -force_min / mass",
                value: stop_deceleration,
            }));
        }
        Ok(Self {
            limits,
            dt: positive("dt", dt)?,
            max_tail_ticks,
            stop_force,
            plan: [[0.0; 2]; MAX_HORIZON],
            length: 0,
            start: 0,
            mode: Mode::Waiting,
            previous: [0.0; 2],
            v_x: f64::INFINITY,
            delta: 0.0,
        })
    }

    /// Takes a plan whose first input is meant for period `tick`.
    ///
    /// # Errors
    /// [`GateError`] when the plan is empty, too long, not finite or older than the one held, or
    /// when the gate is in STOP; the plan held before then stays.
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

    /// What the actuators get in period `tick`, given the measured speed \[m/s\] and steering angle
    /// \[rad\]. A measurement that is not finite, or a held plan without an input for this period, means STOP.
    pub fn command(&mut self, tick: u64, v_x: f64, delta: f64) -> Command {
        let seen = v_x.is_finite() && delta.is_finite();
        if v_x.is_finite() {
            self.v_x = v_x;
        }
        if delta.is_finite() {
            self.delta = delta;
        }
        let planned = if seen && self.mode != Mode::Stop {
            self.planned(tick)
        } else {
            None
        };
        let wanted = if let Some((mode, u)) = planned {
            self.mode = mode;
            u
        } else {
            let waiting = seen && self.length == 0 && self.mode != Mode::Stop;
            self.mode = if waiting { Mode::Waiting } else { Mode::Stop };
            // The steering is held: the car stays on the curve its last plan steered, whereas
            // straightening the wheels in a bend would lead off the road.
            [
                -self.stop_force * (self.v_x / HOLD_SPEED).clamp(-1.0, 1.0),
                0.0,
            ]
        };
        let [force, rate] = self.previous;
        let u = [
            self.limits.force(wanted[0], force, self.v_x, self.dt),
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

    /// Leaves STOP and forgets the plan: the vehicle is braked until a new one is accepted. The slew limits still count
    /// from the last command.
    pub fn reset(&mut self) {
        self.mode = Mode::Waiting;
        self.length = 0;
    }

    /// Stops the vehicle from the next [`Gate::command`] on, whatever plan is held.
    pub fn stop(&mut self) {
        self.mode = Mode::Stop;
    }

    /// Where the last command came from.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The input that the plan held has for `tick`, when it has one that may still be used.
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
