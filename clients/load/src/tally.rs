//! The counts and times of a load test.

use std::collections::BTreeMap;
use std::time::Duration;

use egp_simulator::Period;
use egp_vehicle::{Mode, Outcome};
use hdrhistogram::Histogram;

/// A histogram of microseconds from 1 to a minute with three exact digits.
pub(crate) struct Micros(Histogram<u64>);

impl Default for Micros {
    fn default() -> Self {
        let mut histogram = Histogram::new_with_bounds(1, 60_000_000, 3)
            .unwrap_or_else(|_| unreachable!("the bounds are constant and valid"));
        histogram.auto(false);
        Self(histogram)
    }
}

impl Micros {
    pub(crate) fn record(&mut self, time: Duration) {
        self.0
            .saturating_record(u64::try_from(time.as_micros()).unwrap_or(u64::MAX));
    }

    pub(crate) fn add(&mut self, other: &Self) {
        // Both histograms have the same bounds, so no value can be out of range.
        let _ = self.0.add(&other.0);
    }

    /// Milliseconds at a quantile; zero if nothing was recorded.
    pub(crate) fn quantile(&self, quantile: f64) -> f64 {
        self.0.value_at_quantile(quantile) as f64 / 1e3
    }

    pub(crate) fn len(&self) -> u64 {
        self.0.len()
    }
}

/// Counts and times of one vehicle, or of all.
#[derive(Default)]
pub(crate) struct Tally {
    /// Requests due.
    pub(crate) periods: u64,
    /// Number of requests by their outcome.
    pub(crate) outcomes: BTreeMap<String, u64>,
    /// Number of commands by their mode: normal, tail, stop, waiting.
    pub(crate) modes: [u64; 4],
    /// Time from when a request was due to its answer, for late answers from when it was sent; requests without an answer
    /// have none.
    pub(crate) latency: Micros,
    /// Time in the service's queue.
    pub(crate) queue: Micros,
    /// Time in the service's worker.
    pub(crate) step: Micros,
    /// Time from when a request was due to when the vehicle began it.
    pub(crate) lag: Micros,
    /// Vehicles stopped, spun or lost, and put back.
    pub(crate) put_back: u64,
    /// Largest lateral error, m.
    pub(crate) lateral: f64,
}

impl Tally {
    pub(crate) fn count(&mut self, period: &Period, lag: Duration) {
        let step = &period.step;
        self.periods += 1;
        *self.outcomes.entry(name(&step.outcome)).or_default() += 1;
        self.modes[match step.command.mode {
            Mode::Normal => 0,
            Mode::Tail => 1,
            Mode::Stop => 2,
            Mode::Waiting => 3,
        }] += 1;
        self.lag.record(lag);
        let in_time = step.latency.map(|latency| lag + latency);
        let late = step.late.iter().map(|late| late.latency);
        for latency in late.chain(in_time) {
            self.latency.record(latency);
        }
        if let Some(timing) = &step.timing {
            self.queue
                .record(Duration::from_micros(timing.queue_us.into()));
            self.step
                .record(Duration::from_micros(timing.step_us.into()));
        }
        self.lateral = self.lateral.max(period.projection.lateral.abs());
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.periods += other.periods;
        for (outcome, count) in &other.outcomes {
            *self.outcomes.entry(outcome.clone()).or_default() += count;
        }
        for (mine, theirs) in self.modes.iter_mut().zip(other.modes) {
            *mine += theirs;
        }
        for (mine, theirs) in [
            (&mut self.latency, &other.latency),
            (&mut self.queue, &other.queue),
            (&mut self.step, &other.step),
            (&mut self.lag, &other.lag),
        ] {
            mine.add(theirs);
        }
        self.put_back += other.put_back;
        self.lateral = self.lateral.max(other.lateral);
    }
}

/// The outcome in one word, with the code of an error reply: `solved`, `infeasible`, `late`, `refused: too_late`.
fn name(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Refused(error) => format!("refused: {}", error.code_name()),
        other => other.name().to_owned(),
    }
}
