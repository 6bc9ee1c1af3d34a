//! What a vehicle publishes about itself for displays; `docs/wire.md`, section 13, describes it.

use std::time::{Duration, Instant};

use egp_driver::{Outcome, Step};
use egp_gate::Mode;
use egp_wire::proto::{PeriodTimes, StepRecord, VehicleStatus};
use egp_wire::{ReferenceRow, State, VERSION};

/// Least time between two messages.
const INTERVAL: Duration = Duration::from_millis(100);
/// Control periods whose times one message has at most.
const KEPT_TIMES: usize = 64;

/// What stays the same in all messages of a vehicle.
pub(crate) struct Constants {
    /// Random number of this publication.
    pub(crate) run: u64,
    /// Control period, s.
    pub(crate) dt: f64,
    /// Time that a step may take.
    pub(crate) deadline: Duration,
    /// Surfaces of the library.
    pub(crate) members: Vec<String>,
}

/// One control period as the vehicle saw it.
pub(crate) struct Period<'a> {
    pub(crate) step: &'a Step,
    /// Measured state.
    pub(crate) x: State,
    /// Row 0 of the reference, if there is one.
    pub(crate) reference: Option<ReferenceRow>,
    /// Weights of the newest reply.
    pub(crate) weights: &'a [f64],
    /// From the call to the command.
    pub(crate) total: Duration,
}

/// Counts the control periods of a vehicle and makes its messages.
pub(crate) struct Status {
    constants: Constants,
    began: Instant,
    next: Instant,
    periods: u64,
    misses: u64,
    tails: u64,
    times: Vec<PeriodTimes>,
}

impl Status {
    pub(crate) fn new(constants: Constants, now: Instant) -> Self {
        Self {
            constants,
            began: now,
            next: now,
            periods: 0,
            misses: 0,
            tails: 0,
            times: Vec::with_capacity(KEPT_TIMES),
        }
    }

    /// Counts a period; returns a message if the last one is 0.1 s old.
    pub(crate) fn add(&mut self, period: &Period<'_>, now: Instant) -> Option<VehicleStatus> {
        let step = period.step;
        // A plan that came after the deadline is driven, and is still none in time.
        let missed = step.command.mode != Mode::Normal || step.outcome == Outcome::Late;
        self.periods += 1;
        self.misses += u64::from(missed);
        self.tails += u64::from(step.command.mode == Mode::Tail);
        let (queue, compute) = step
            .timing
            .as_ref()
            .map_or((0, 0), |timing| (timing.queue_us, timing.step_us));
        if self.times.len() == KEPT_TIMES {
            self.times.remove(0);
        }
        self.times.push(PeriodTimes {
            total_ms: 1e3 * period.total.as_secs_f32(),
            queue_ms: 1e3 * micros(queue).as_secs_f32(),
            compute_ms: 1e3 * micros(compute).as_secs_f32(),
            missed,
        });
        if now < self.next {
            return None;
        }
        // A period that is a little late does not delay the messages after it.
        self.next = self.next.max(now.checked_sub(INTERVAL).unwrap_or(now)) + INTERVAL;
        let plan = step.reply.iter().flat_map(|reply| &reply.plan_x);
        let record = self.record(period, queue, compute, now);
        Some(VehicleStatus {
            version: VERSION,
            run: self.constants.run,
            periods: self.periods,
            misses: self.misses,
            tails: self.tails,
            dt: self.constants.dt,
            deadline_ms: milliseconds(self.constants.deadline),
            members: self.constants.members.clone(),
            step: Some(record),
            truth: None,
            lateral_error: period
                .reference
                .map_or(f64::NAN, |row| lateral(&period.x, &row)),
            plan: plan.flat_map(|[p_x, p_y, ..]| [*p_x, *p_y]).collect(),
            times: std::mem::take(&mut self.times),
            ended: false,
        })
    }

    fn record(&self, period: &Period<'_>, queue: u32, compute: u32, now: Instant) -> StepRecord {
        let step = period.step;
        let [p_x, p_y, v_x, psi, v_y, omega, delta] = period.x;
        let [force, steering_rate] = step.command.u;
        let friction = step.reply.as_ref().and_then(|reply| reply.friction);
        let lost = step.lost.map(|lost| lost.to_string());
        StepRecord {
            time: now.duration_since(self.began).as_secs_f64(),
            p_x,
            p_y,
            v_x,
            psi,
            v_y,
            omega,
            delta,
            force,
            steering_rate,
            mode: step.command.mode.name().to_owned(),
            status: step.outcome.name().to_owned(),
            lost: lost.is_some(),
            detail: lost.unwrap_or_else(|| step.outcome.detail()),
            limited: step.command.limited,
            weights: period.weights.to_vec(),
            friction_mean: friction.map_or(f64::NAN, |found| found.mean),
            friction_lower: friction.map_or(f64::NAN, |found| found.lower),
            friction_upper: friction.map_or(f64::NAN, |found| found.upper),
            friction_information: friction.map_or(f64::NAN, |found| found.information),
            envelope_distance: step
                .situation
                .map_or(f64::NAN, |here| here.envelope_distance),
            total_ms: milliseconds(period.total),
            queue_ms: milliseconds(micros(queue)),
            compute_ms: milliseconds(micros(compute)),
            replica: step
                .replica
                .as_ref()
                .map_or_else(String::new, ToString::to_string),
        }
    }
}

/// Distance of the vehicle from the line through a reference row in the direction of its yaw, m, left positive.
fn lateral(x: &State, [p_x, p_y, _, psi]: &ReferenceRow) -> f64 {
    psi.cos() * (x[1] - p_y) - psi.sin() * (x[0] - p_x)
}

fn micros(time: u32) -> Duration {
    Duration::from_micros(time.into())
}

fn milliseconds(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lateral_error_is_positive_on_the_left() {
        let mut x = [0.0; 7];
        x[0] = -2.0;
        // The reference points along +y, so that smaller p_x are on its left.
        let reference = [1.0, 5.0, 10.0, std::f64::consts::FRAC_PI_2];
        assert!((lateral(&x, &reference) - 3.0).abs() < 1e-12);
    }
}
