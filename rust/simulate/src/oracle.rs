//! What must hold in each control period, judged from the truth of the simulation.

use std::collections::BTreeMap;
use std::time::Duration;

use egp_driver::Step;
use egp_gate::{Limits, Mode};
use egp_wire::{Code, Reply, WireError};

use crate::ledger::{Ledger, hash};

/// One of the promises.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Oracle {
    /// Each control period has one command, which comes by its deadline.
    Command,
    /// Commands are finite and within the limits of value and slew, of the motor's power and of the steering angle.
    Limits,
    /// A command is the planned input of the newest plan for this period. It is braking until a plan is driven, and from the
    /// end of that plan's tail or a lost vehicle until the reset. Periods in which the vehicle's program was held up count if
    /// they are more than the tail.
    Tail,
    /// A reply that is used was made by an engine for a request of this vehicle; one that decides a period answers the
    /// request of that period.
    Match,
    /// A vehicle that reaches a sound replica gets replies.
    Starvation,
    /// A vehicle gets replies a second after all replicas and routers are sound.
    Outage,
    /// A replica that runs answers each query exactly once, and does not pause without a fault.
    Answered,
    /// A replica serves a library as long as vehicles ask it for the library.
    Library,
    /// Each error that a replica sends is an `egp.v1.Error` with a code.
    Typed,
    /// Queues and outstanding queries are bounded.
    Memory,
    /// The same seed gives the same trace.
    Repeat,
}

/// A promise that was broken.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// The promise.
    pub oracle: Oracle,
    /// Virtual time.
    pub at: Duration,
    /// What happened.
    pub detail: String,
}

/// Relative rounding of the limits.
const ROUNDING: f64 = 1e-9;
/// Steering rate, rad/s, that is more than rounding of the largest one that keeps the end of the steering angle's range.
const MORE: f64 = 1e-6;
/// Deceleration of a stop, m/s², if the limits allow it, and the speed, m/s, below which it decreases linearly to zero.
const STOP_DECELERATION: f64 = 3.0;
const HOLD_SPEED: f64 = 0.5;

/// The oracles of one vehicle.
pub(crate) struct VehicleOracles {
    limits: Limits,
    dt: f64,
    max_tail: u64,
    /// When the next control period is due on the vehicle's clock; none before the first one and after a reset.
    due: Option<Duration>,
    previous: [f64; 2],
    /// Speed, m/s, and steering angle, rad, of the newest measurement.
    measured: [f64; 2],
    /// Number of the present control period.
    period: u64,
    /// Period of each request, by its hash.
    requests: BTreeMap<u64, u64>,
    /// Period of the request that the newest reply answers.
    newest: u64,
    /// Period and inputs of the newest plan.
    plan: Option<(u64, Vec<[f64; 2]>)>,
    /// Whether a plan was driven since the start or a reset.
    driven: bool,
    /// Whether the vehicle must stop, until it is reset.
    stopped: bool,
    /// Commands of the present period.
    pub(crate) commands: u32,
    /// When the last reply was used.
    pub(crate) replied: Duration,
}

impl VehicleOracles {
    pub(crate) fn new(limits: Limits, dt: f64, max_tail: u64) -> Self {
        Self {
            limits,
            dt,
            max_tail,
            due: None,
            previous: [0.0; 2],
            measured: [f64::INFINITY, 0.0],
            period: 0,
            requests: BTreeMap::new(),
            newest: 0,
            plan: None,
            driven: false,
            stopped: false,
            commands: 0,
            replied: Duration::ZERO,
        }
    }

    /// A control period begins at a time on the vehicle's clock.
    pub(crate) fn begin(&mut self, time: Duration) {
        self.count_held_up(time);
        self.due = Some(time + Duration::from_secs_f64(self.dt));
        self.period += 1;
        self.commands = 0;
        let oldest = self.period.saturating_sub(200);
        self.requests.retain(|_, period| *period >= oldest);
    }

    /// Counts the periods that have passed since the next one was due, if the tail has ended in them.
    fn count_held_up(&mut self, time: Duration) {
        let Some(due) = self.due else { return };
        let mut end = due + Duration::from_secs_f64(self.dt);
        let mut periods = 0;
        while end <= time {
            periods += 1;
            end += Duration::from_secs_f64(self.dt);
        }
        if periods > self.max_tail {
            self.period += periods;
            self.due = Some(time);
        }
    }

    /// The vehicle's driver was reset: no plan is held, and replies to earlier requests are not used.
    pub(crate) fn reset(&mut self) {
        self.plan = None;
        self.due = None;
        self.newest = self.period;
        self.driven = false;
        self.stopped = false;
    }

    pub(crate) fn asked(&mut self, request: &[u8]) {
        self.requests.insert(hash(request), self.period);
    }

    /// Judges a command at a `time` on the vehicle's clock, for a measured speed, m/s, and steering angle, rad; returns what it
    /// breaks.
    pub(crate) fn judge(
        &mut self,
        now: Duration,
        time: Duration,
        measured: [f64; 2],
        step: &Step,
        ledger: &Ledger,
    ) -> Vec<(Oracle, String)> {
        let mut broken = Vec::new();
        self.commands += 1;
        if self.commands > 1 {
            broken.push((Oracle::Command, "a second command in one period".to_owned()));
        }
        self.measured = measured;
        self.limits(step.command.u, &mut broken);
        // Late replies have come before the one that decides the period.
        for late in &step.late {
            self.take(&late.reply_bytes, ledger, None, &mut broken);
        }
        if step.reply.is_some() {
            self.replied = now;
            self.take(&step.reply_bytes, ledger, Some(self.period), &mut broken);
        }
        self.count_held_up(time);
        self.stopped |= step.lost.is_some();
        self.source(step, &mut broken);
        self.previous = step.command.u;
        broken
    }

    /// Checks who made a reply, and keeps its plan if no newer reply has come before.
    fn take(
        &mut self,
        bytes: &[u8],
        ledger: &Ledger,
        expected: Option<u64>,
        broken: &mut Vec<(Oracle, String)>,
    ) {
        let made_for = ledger.requests(bytes);
        let period = made_for
            .iter()
            .find_map(|request| self.requests.get(request).copied());
        let Some(period) = period.filter(|made| expected.is_none_or(|own| own == *made)) else {
            let detail = if made_for.is_empty() {
                "a reply was used that no engine made"
            } else {
                "a reply was used that answers another request"
            };
            return broken.push((Oracle::Match, detail.to_owned()));
        };
        if period <= self.newest {
            return;
        }
        self.newest = period;
        let plan = Reply::decode(bytes).map(|reply| reply.plan_u);
        if let Some(plan_u) = plan.ok().filter(|plan_u| !plan_u.is_empty()) {
            self.plan = Some((period, plan_u));
        }
    }

    fn limits(&self, u: [f64; 2], broken: &mut Vec<(Oracle, String)>) {
        let [force, rate] = u;
        let limits = &self.limits;
        let within = |value: f64, low: f64, high: f64| {
            let slack = ROUNDING * (high - low);
            value >= low - slack && value <= high + slack
        };
        let (force_step, rate_step) = (limits.force_slew * self.dt, limits.steering_slew * self.dt);
        let [last_force, last_rate] = self.previous;
        for (name, holds) in [
            ("force", within(force, limits.force_min, limits.force_max)),
            (
                "steering rate",
                within(rate, -limits.steering_rate, limits.steering_rate),
            ),
            (
                "slew of the force",
                within(force - last_force, -force_step, force_step),
            ),
            (
                "slew of the steering rate",
                within(rate - last_rate, -rate_step, rate_step),
            ),
            // If the power falls faster than the slew allows, the force falls as fast as the slew allows.
            (
                "power",
                force <= self.powered().max(last_force - force_step) + self.slack()[0],
            ),
            (
                "steering angle",
                self.steers_within(rate, 1.0) && self.steers_within(rate, -1.0),
            ),
        ] {
            if !holds {
                let detail = format!(
                    "{name} of {u:?} after {:?} at [v_x, delta] = {:?}",
                    self.previous, self.measured
                );
                broken.push((Oracle::Limits, detail));
            }
        }
    }

    /// The driving force, N, for which the motor's power suffices.
    fn powered(&self) -> f64 {
        self.limits.power / self.measured[0].abs()
    }

    /// What rounding may change in force, N, and steering rate, rad/s.
    fn slack(&self) -> [f64; 2] {
        let limits = &self.limits;
        let ranges = [
            limits.force_max - limits.force_min,
            2.0 * limits.steering_rate,
        ];
        ranges.map(|range| ROUNDING * range)
    }

    /// Whether the wheels keep the steering angle's limit on one side (1 or -1) when the steering rate goes to zero after this
    /// command as fast as its slew allows. If the slew or the largest rate allows no better one, a command holds as well.
    fn steers_within(&self, rate: f64, side: f64) -> bool {
        let limits = &self.limits;
        let step = limits.steering_slew * self.dt;
        let (rate, last) = (side * rate, side * self.previous[1]);
        let lowest = (last - step).max(-limits.steering_rate);
        if rate <= lowest + self.slack()[1] {
            return true;
        }
        let mut rate = rate.min(limits.steering_rate);
        let mut angle = side * self.measured[1] + rate * self.dt;
        while rate > step {
            rate -= step;
            angle += rate * self.dt;
        }
        angle <= limits.steering_angle * (1.0 + ROUNDING)
    }

    /// Checks the mode of a command, and that the command is what this mode is for.
    fn source(&mut self, step: &Step, broken: &mut Vec<(Oracle, String)>) {
        let command = &step.command;
        let age = self.plan.as_ref().map(|(period, _)| self.period - period);
        let planned = self.planned();
        let due = match (age, planned) {
            _ if self.stopped => Mode::Stop,
            (Some(0), Some(_)) => Mode::Normal,
            (Some(_), Some(_)) => Mode::Tail,
            (Some(_), None) if self.driven => Mode::Stop,
            (Some(_), None) | (None, _) => Mode::Waiting,
        };
        self.driven |= matches!(due, Mode::Normal | Mode::Tail);
        self.stopped = due == Mode::Stop;
        if command.mode != due {
            let text = format!(
                "mode {:?} with a plan of age {age:?}, due is {due:?}",
                command.mode
            );
            return broken.push((Oracle::Tail, text));
        }
        let u = command.u;
        let holds = match planned.filter(|_| !self.stopped) {
            Some(planned) => planned == u || (command.limited && self.towards(planned, u)),
            None => self.brakes(u),
        };
        if !holds {
            let planned = planned.filter(|_| !self.stopped);
            let text = format!(
                "{u:?} is driven after {:?} at [v_x, delta] = {:?} in mode {due:?}, planned is {planned:?}",
                self.previous, self.measured
            );
            broken.push((Oracle::Tail, text));
        }
    }

    /// The input of the newest plan for this period; none if the plan has no such input or its tail has ended.
    fn planned(&self) -> Option<[f64; 2]> {
        let (period, plan_u) = self.plan.as_ref()?;
        let age = Some(self.period - period).filter(|age| *age <= self.max_tail)?;
        plan_u.get(usize::try_from(age).ok()?).copied()
    }

    /// Whether the command brakes: the force goes to that of a stop, and the steering rate to zero, as fast as their slew
    /// allows. Wheels beyond the limit of the steering angle may return.
    fn brakes(&self, u: [f64; 2]) -> bool {
        let [v_x, delta] = self.measured;
        let limits = &self.limits;
        let stopping = (-limits.mass * STOP_DECELERATION).max(limits.force_min);
        let force = stopping * (v_x / HOLD_SPEED).clamp(-1.0, 1.0);
        let held = self.approached(1, 0.0);
        let held = (u[1] - held).abs() <= self.slack()[1];
        self.forced(force, u[0]) && (held || delta.abs() > limits.steering_angle)
    }

    /// Whether limits explain that `u` is driven in place of the planned input. The force is the nearest one that they
    /// allow. So is the steering rate, or it is the largest one that keeps the end of the steering angle's range.
    fn towards(&self, planned: [f64; 2], u: [f64; 2]) -> bool {
        let end = self.limits.steering_rate;
        let near = |value: f64| (u[1] - value).abs() <= self.slack()[1];
        let smaller = u[1] * planned[1] >= 0.0 && u[1].abs() <= planned[1].abs();
        let side = planned[1].signum();
        let largest = || !self.steers_within(side * (u[1].abs() + MORE), side);
        self.forced(planned[0], u[0])
            && (near(self.approached(1, planned[1].clamp(-end, end))) || (smaller && largest()))
    }

    /// Whether `force` is the nearest one to `wanted` that the limits allow.
    fn forced(&self, wanted: f64, force: f64) -> bool {
        let Limits {
            force_min,
            force_max,
            ..
        } = self.limits;
        let wanted = wanted.clamp(force_min, force_max).min(self.powered());
        (force - self.approached(0, wanted)).abs() <= self.slack()[0]
    }

    /// The last command's component `i`, changed to `wanted` as far as the slew allows in one period. A component that is not
    /// a number breaks the limits already, and is no limit here.
    fn approached(&self, i: usize, wanted: f64) -> f64 {
        let slew = [self.limits.force_slew, self.limits.steering_slew][i];
        let (last, step) = (self.previous[i], slew * self.dt);
        wanted.max(last - step).min(last + step)
    }
}

/// Whether the bytes are an error that states its reason.
pub(crate) fn typed(bytes: &[u8]) -> bool {
    WireError::decode(bytes).is_ok_and(|error| error.code != Code::Unspecified)
}
