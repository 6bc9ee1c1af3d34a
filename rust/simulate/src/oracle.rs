//! What must hold in each control period, judged from the truth of the simulation.

use std::collections::BTreeMap;
use std::time::Duration;

use egp_driver::Step;
use egp_gate::{Limits, Mode};
use egp_wire::{Code, MessageLimits, Reply, WireError};

use crate::ledger::{Ledger, hash};

/// One of the promises.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Oracle {
    /// Each control period has one command, which comes by its deadline.
    Command,
    /// Commands are finite and within the limits of value and slew.
    Limits,
    /// A command is the planned input of the newest plan for this period, or braking once that plan's tail has ended.
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

/// The oracles of one vehicle.
pub(crate) struct VehicleOracles {
    limits: Limits,
    dt: f64,
    max_tail: u64,
    previous: [f64; 2],
    /// Number of the present control period.
    period: u64,
    /// Period of each request, by its hash.
    requests: BTreeMap<u64, u64>,
    /// Period and inputs of the newest plan.
    plan: Option<(u64, Vec<[f64; 2]>)>,
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
            previous: [0.0; 2],
            period: 0,
            requests: BTreeMap::new(),
            plan: None,
            commands: 0,
            replied: Duration::ZERO,
        }
    }

    pub(crate) fn begin(&mut self) {
        self.period += 1;
        self.commands = 0;
        let oldest = self.period.saturating_sub(200);
        self.requests.retain(|_, period| *period >= oldest);
    }

    pub(crate) fn forget_plan(&mut self) {
        self.plan = None;
    }

    pub(crate) fn asked(&mut self, request: &[u8]) {
        self.requests.insert(hash(request), self.period);
    }

    /// Judges a command; returns what it breaks.
    pub(crate) fn judge(
        &mut self,
        now: Duration,
        step: &Step,
        ledger: &Ledger,
    ) -> Vec<(Oracle, String)> {
        let mut broken = Vec::new();
        self.commands += 1;
        if self.commands > 1 {
            broken.push((Oracle::Command, "a second command in one period".to_owned()));
        }
        let previous = self.previous;
        self.limits(step.command.u, &mut broken);
        if step.reply.is_some() {
            self.replied = now;
            self.take(&step.reply_bytes, ledger, Some(self.period), &mut broken);
        }
        for late in &step.late {
            self.take(&late.reply_bytes, ledger, None, &mut broken);
        }
        self.tail(step, previous, &mut broken);
        broken
    }

    /// Checks who made a reply, and keeps its plan if it is the newest.
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
        let plan = Reply::decode(bytes, &MessageLimits::default()).map(|reply| reply.plan_u);
        let newer = self.plan.as_ref().is_none_or(|(held, _)| *held <= period);
        if let Some(plan_u) = plan.ok().filter(|plan_u| !plan_u.is_empty() && newer) {
            self.plan = Some((period, plan_u));
        }
    }

    fn limits(&mut self, u: [f64; 2], broken: &mut Vec<(Oracle, String)>) {
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
        ] {
            if !holds {
                broken.push((
                    Oracle::Limits,
                    format!("{name} of {u:?} after {:?}", self.previous),
                ));
            }
        }
        self.previous = u;
    }

    fn tail(&self, step: &Step, previous: [f64; 2], broken: &mut Vec<(Oracle, String)>) {
        let command = &step.command;
        let newest = self.plan.as_ref();
        let age = newest.map(|(period, _)| self.period - period);
        let allowed = match command.mode {
            Mode::Normal => age == Some(0),
            Mode::Tail => age.is_some_and(|age| (1..=self.max_tail).contains(&age)),
            Mode::Waiting => age.is_none(),
            // A stop is always allowed; the force that drives then falls as fast as its slew allows.
            Mode::Stop => {
                let left = previous[0] - self.limits.force_slew * self.dt;
                command.u[0] <= left.max(0.0) + ROUNDING * self.limits.force_max
            }
        };
        if !allowed {
            let text = format!("mode {:?} with a plan of age {age:?}", command.mode);
            broken.push((Oracle::Tail, text));
        }
        let planned = newest
            .zip(age)
            .and_then(|((_, plan_u), age)| plan_u.get(usize::try_from(age).unwrap_or(usize::MAX)));
        let driven = matches!(command.mode, Mode::Normal | Mode::Tail);
        if let Some(planned) = planned.filter(|_| driven)
            && *planned != command.u
            && !(command.limited && self.towards(*planned, previous, command.u))
        {
            let text = format!(
                "{:?} is driven after {previous:?}, planned is {planned:?}",
                command.u
            );
            broken.push((Oracle::Tail, text));
        }
    }

    /// Whether limits explain that `u` is driven in place of the planned input: each component is the planned one, an end
    /// of its range, or the last one changed towards the planned one as fast as its slew allows. The power makes the
    /// driving force smaller, and the end of the steering angle's range the steering rate.
    fn towards(&self, planned: [f64; 2], previous: [f64; 2], u: [f64; 2]) -> bool {
        let limits = &self.limits;
        let ranges = [
            (limits.force_min, limits.force_max, limits.force_slew),
            (
                -limits.steering_rate,
                limits.steering_rate,
                limits.steering_slew,
            ),
        ];
        (0..2).all(|i| {
            let (low, high, slew) = ranges[i];
            let near = |value: f64| (u[i] - value).abs() <= ROUNDING * (high - low);
            let step = slew * self.dt * (planned[i] - previous[i]).signum();
            let smaller = u[i] * planned[i] >= 0.0 && u[i].abs() <= planned[i].abs();
            let may_be_smaller = i == 1 || planned[i] > 0.0;
            near(planned[i])
                || near(planned[i].clamp(low, high))
                || near(previous[i] + step)
                || (smaller && may_be_smaller)
        })
    }
}

/// Whether the bytes are an error that states its reason.
pub(crate) fn typed(bytes: &[u8]) -> bool {
    WireError::decode(bytes).is_ok_and(|error| error.code != Code::Unspecified)
}
