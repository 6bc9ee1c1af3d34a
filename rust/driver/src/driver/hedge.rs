//! When a second replica is asked although the first one may still answer.

use std::time::Duration;

use super::Time;

/// Second questions per control period in the long run.
const SHARE: f64 = 0.05;
/// Second questions that may follow one another.
const BURST: f64 = 3.0;

/// How many second questions a vehicle may ask.
///
/// A replica that is silent for long is likely to stay silent until the deadline, and an answer of another one then saves
/// the period (hedged requests; Dean and Barroso, *The Tail at Scale*, Communications of the ACM 56(2), 2013). If all
/// replicas are slow because they are busy, second questions would make them slower, so a token bucket limits them.
#[derive(Clone, Debug)]
pub(super) struct HedgeAllowance {
    /// Part of the time until the deadline that replicas have before a second one is asked.
    part: f64,
    tokens: f64,
}

impl HedgeAllowance {
    pub(super) fn new(part: f64) -> Self {
        Self {
            part,
            tokens: BURST,
        }
    }

    /// Begins a control period, and returns the time at which a second replica is to be asked, or `None` if no token is
    /// left. With a part of 1 that time is the deadline, which decides the period first.
    pub(super) fn open(&mut self, now: Time, deadline: Time) -> Option<Time> {
        self.tokens = (self.tokens + SHARE).min(BURST);
        let wait = || {
            let left = deadline.saturating_sub(now).as_secs_f64();
            Duration::try_from_secs_f64(left * self.part).unwrap_or(Time::MAX)
        };
        (self.tokens >= 1.0).then(|| now.saturating_add(wait()))
    }

    /// A second question is asked.
    pub(super) fn spend(&mut self) {
        self.tokens -= 1.0;
    }
}
