//! The result, for people and for programs.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use serde::Serialize;

use crate::tally::{Micros, Tally};

/// Quantiles in milliseconds; infinite, and `null` in JSON, where the request of that rank had no answer.
#[derive(Serialize)]
pub(crate) struct Quantiles {
    count: u64,
    pub(crate) p50: f64,
    pub(crate) p99: f64,
    pub(crate) p999: f64,
    max: f64,
}

impl Quantiles {
    /// The quantiles as columns of 9 characters; a dash where nothing was recorded.
    fn columns(&self) -> String {
        let column = |time: f64| {
            if self.count == 0 && time.is_finite() {
                format!("{:>9}", "-")
            } else {
                format!("{time:9.2}")
            }
        };
        [self.p50, self.p99, self.p999, self.max]
            .map(column)
            .concat()
    }

    /// Quantiles of what was recorded.
    pub(crate) fn of(times: &Micros) -> Self {
        Self::of_requests(times, times.len())
    }

    /// Quantiles over all `requests`. Those without a recorded time had no reply or were refused, and count as slower than all
    /// others: they would otherwise make a service that is silent or overloaded look fast.
    pub(crate) fn of_requests(times: &Micros, requests: u64) -> Self {
        let count = times.len();
        let quantile = |quantile: f64| {
            let rank = quantile * requests.max(count) as f64;
            if rank > count as f64 {
                f64::INFINITY
            } else {
                times.quantile(rank / count.max(1) as f64)
            }
        };
        Self {
            count,
            p50: quantile(0.5),
            p99: quantile(0.99),
            p999: quantile(0.999),
            max: quantile(1.0),
        }
    }
}

/// The result of a load test; times in milliseconds.
#[derive(Serialize)]
pub(crate) struct Report {
    vehicles: u32,
    seconds: f64,
    requests: u64,
    requests_per_second: f64,
    misses: u64,
    miss_fraction: f64,
    pub(crate) outcomes: BTreeMap<String, u64>,
    normal_periods: u64,
    tail_periods: u64,
    stop_periods: u64,
    waiting_periods: u64,
    put_back: u64,
    max_lateral_error_m: f64,
    latency_ms: Quantiles,
    service_queue_ms: Quantiles,
    service_step_ms: Quantiles,
    generator_lag_ms: Quantiles,
}

impl Report {
    pub(crate) fn new(tally: &Tally, vehicles: u32, measured: Duration) -> Self {
        let seconds = measured.as_secs_f64();
        let misses = tally.periods - tally.outcomes.get("solved").copied().unwrap_or(0);
        let [normal_periods, tail_periods, stop_periods, waiting_periods] = tally.modes;
        Self {
            vehicles,
            seconds,
            requests: tally.periods,
            requests_per_second: tally.periods as f64 / seconds,
            misses,
            miss_fraction: misses as f64 / tally.periods.max(1) as f64,
            outcomes: tally.outcomes.clone(),
            normal_periods,
            tail_periods,
            stop_periods,
            waiting_periods,
            put_back: tally.put_back,
            max_lateral_error_m: tally.lateral,
            latency_ms: Quantiles::of_requests(&tally.latency, tally.periods),
            service_queue_ms: Quantiles::of(&tally.queue),
            service_step_ms: Quantiles::of(&tally.step),
            generator_lag_ms: Quantiles::of(&tally.lag),
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} vehicles, {} s: {} requests ({:.1} a second), {} misses ({:.2} %)",
            self.vehicles,
            self.seconds,
            self.requests,
            self.requests_per_second,
            self.misses,
            self.miss_fraction * 100.0
        )?;
        writeln!(
            f,
            "{:24}{:>9}{:>9}{:>9}{:>9}{:>9}",
            "ms", "p50", "p99", "p99.9", "max", "count"
        )?;
        for (name, times) in [
            ("latency from due time", &self.latency_ms),
            ("  in the queue", &self.service_queue_ms),
            ("  in the step", &self.service_step_ms),
            ("generator lag", &self.generator_lag_ms),
        ] {
            writeln!(f, "{name:24}{}{:9}", times.columns(), times.count)?;
        }
        if self.latency_ms.max.is_infinite() {
            writeln!(
                f,
                "inf: requests without a reply or refused, which count as slower than all others"
            )?;
        }
        let outcomes: Vec<String> = self
            .outcomes
            .iter()
            .map(|(outcome, count)| format!("{count} {outcome}"))
            .collect();
        writeln!(f, "answers: {}", outcomes.join(", "))?;
        write!(
            f,
            "commands: {} normal, {} tail, {} stop, {} waiting; put back {}; largest lateral error {:.2} m",
            self.normal_periods,
            self.tail_periods,
            self.stop_periods,
            self.waiting_periods,
            self.put_back,
            self.max_lateral_error_m
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_without_an_answer_are_slower_than_all_others() {
        let mut times = Micros::default();
        for _ in 0..80 {
            times.record(Duration::from_millis(2));
        }
        let answered = Quantiles::of(&times);
        assert!(answered.p999 < 2.1 && answered.max < 2.1);
        let all = Quantiles::of_requests(&times, 100);
        assert!(all.p50 < 2.1);
        assert!(
            [all.p99, all.p999, all.max]
                .iter()
                .all(|time| time.is_infinite())
        );
        assert!(
            Quantiles::of_requests(&Micros::default(), 100)
                .p50
                .is_infinite()
        );
        assert!(Quantiles::of(&Micros::default()).max == 0.0);
        let none = Quantiles::of(&Micros::default()).columns();
        assert_eq!(none, "        -".repeat(4));
        assert!(all.columns().starts_with("     2.00"), "{}", all.columns());
        let json = serde_json::to_value(&all).unwrap_or_default();
        assert!(json["p99"].is_null() && json["count"] == 80);
    }
}
