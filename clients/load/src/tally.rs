//! The counts and times of a load test.

use std::collections::BTreeMap;
use std::time::Duration;

use egp_simulator::Period;
use egp_vehicle::{Mode, Outcome, Step};
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
    /// Time from when a request was due to its reply, for late replies from when it was sent; requests without a reply, and
    /// those that were refused, have none.
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
        for latency in latencies(step, lag) {
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

/// The latencies of the replies in a step, which began `lag` after its request was due.
fn latencies(step: &Step, lag: Duration) -> impl Iterator<Item = Duration> {
    let late = step.late.iter().map(|late| late.latency);
    let in_time = step.reply.as_ref().and(step.latency);
    late.chain(in_time.map(|latency| lag + latency))
}

/// The outcome in one word, with the code of an error reply: `solved`, `infeasible`, `late`, `refused: too_late`.
fn name(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Refused(error) => format!("refused: {}", error.code_name()),
        other => other.name().to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use egp_testing::messages;
    use egp_vehicle::{Command, Late};
    use egp_wire::{Code, Status, WireError};

    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn only_replies_have_a_latency() {
        let mut step = Step {
            command: Command {
                u: [0.0; 2],
                mode: Mode::Tail,
                limited: false,
            },
            outcome: Outcome::Refused(WireError::permanent(Code::TooLate, "")),
            replica: None,
            request: Vec::new(),
            reply: None,
            reply_bytes: Vec::new(),
            latency: Some(MS),
            timing: None,
            late: Vec::new(),
            asked: 1,
            situation: None,
            lost: None,
            held_up: 0,
        };
        assert_eq!(latencies(&step, MS).next(), None);
        step.late.push(Late {
            latency: 30 * MS,
            reply_bytes: Vec::new(),
        });
        assert_eq!(latencies(&step, MS).collect::<Vec<_>>(), [30 * MS]);
        step.outcome = Outcome::Replied(Status::Solved);
        step.reply = Some(messages::solved_reply());
        assert_eq!(latencies(&step, MS).collect::<Vec<_>>(), [30 * MS, 2 * MS]);
    }
}
