//! A replay with a given number of vehicles, or with more and more of them up to the knee.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use egp_wire::Interrupt;
use serde::Serialize;

use crate::counts::Counts;
use crate::replay::Replay;
use crate::report::Quantiles;
use crate::unsolved::{is_too_slow, unsolved};
use crate::{Arguments, Failure, whole_periods};

/// Each step of a ramp has this many times the vehicles of the step before.
const GROWTH: f64 = 1.25;

/// One number of vehicles; times in milliseconds.
#[derive(Serialize)]
pub(crate) struct Rate {
    vehicles: usize,
    requests: u64,
    requests_per_second: f64,
    in_deadline: u64,
    in_deadline_fraction: f64,
    in_deadline_per_second: f64,
    /// Fraction of the vehicle with the smallest one.
    least_vehicle_fraction: f64,
    outcomes: BTreeMap<String, u64>,
    latency_ms: Quantiles,
    service_queue_ms: Quantiles,
    service_step_ms: Quantiles,
    generator_lag_ms: Quantiles,
}

impl Rate {
    fn new(counts: &Counts, measured: Duration) -> Self {
        let seconds = measured.as_secs_f64();
        let fraction = |[all, in_time]: [u64; 2]| in_time as f64 / all.max(1) as f64;
        let sums = counts.vehicles.iter().fold([0, 0], |sum, vehicle| {
            [sum[0] + vehicle[0], sum[1] + vehicle[1]]
        });
        let least = counts.vehicles.iter().copied().map(fraction);
        Self {
            vehicles: counts.vehicles.len(),
            requests: sums[0],
            requests_per_second: sums[0] as f64 / seconds,
            in_deadline: sums[1],
            in_deadline_fraction: fraction(sums),
            in_deadline_per_second: sums[1] as f64 / seconds,
            least_vehicle_fraction: least.fold(1.0, f64::min),
            outcomes: counts.outcomes.clone(),
            latency_ms: Quantiles::of_requests(&counts.latency, sums[0]),
            service_queue_ms: Quantiles::of(&counts.queue),
            service_step_ms: Quantiles::of(&counts.step),
            generator_lag_ms: Quantiles::of(&counts.lag),
        }
    }
}

/// The result of a replay.
#[derive(Serialize)]
pub(crate) struct Ramp {
    period_s: f64,
    seconds: f64,
    /// Least fraction of requests answered by their deadline at which a rate counts as held; without it a single rate was
    /// measured.
    hold: Option<f64>,
    /// Largest number of vehicles at which this fraction was reached; absent if it was never reached or not stated. If this
    /// is the last rate, the knee is at a higher rate.
    knee_vehicles: Option<usize>,
    /// Whether Ctrl-C ended the measurement. The last rate is then incomplete if it was interrupted after its warm-up.
    pub(crate) interrupted: bool,
    pub(crate) rates: Vec<Rate>,
}

impl Ramp {
    /// Why nothing was solved, if that is no result: a ramp looks for the number of vehicles at which answers come too late.
    pub(crate) fn unsolved(&self) -> Option<String> {
        let mut outcomes = BTreeMap::new();
        for (outcome, count) in self.rates.iter().flat_map(|rate| &rate.outcomes) {
            *outcomes.entry(outcome.clone()).or_default() += count;
        }
        let is_result = self.hold.is_some() && outcomes.keys().any(|name| is_too_slow(name));
        unsolved(&outcomes).filter(|_| !is_result)
    }
}

/// Replays with the number of vehicles that the arguments state and, if they ask for a ramp, with more until the fraction
/// of requests answered in the deadline is below `hold`, or until Ctrl-C.
///
/// # Errors
/// A message of [`Replay::run`].
pub(crate) fn ramp(
    arguments: &Arguments,
    replay: &mut Replay<'_>,
    interrupt: &Interrupt,
) -> Result<Ramp, Failure> {
    let [warm_up, measured] =
        [arguments.warm_up, arguments.seconds].map(|time| whole_periods(time, replay.period));
    if arguments.most < arguments.vehicles {
        let (most, vehicles) = (arguments.most, arguments.vehicles);
        return Err(format!(
            "the ramp begins with {vehicles} vehicles and ends at {most}: choose a larger --most or fewer --vehicles"
        )
        .into());
    }
    let mut result = Ramp {
        period_s: replay.period.as_secs_f64(),
        seconds: measured.as_secs_f64(),
        hold: arguments.ramp,
        knee_vehicles: None,
        interrupted: false,
        rates: Vec::new(),
    };
    let mut vehicles = f64::from(arguments.vehicles);
    while vehicles <= f64::from(arguments.most) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 1 to 2000
        let count = vehicles as usize;
        let (counts, measured) = replay.run(count, warm_up, measured, interrupt)?;
        if interrupt.came() {
            result.interrupted = true;
            if !measured.is_zero() {
                result.rates.push(Rate::new(&counts, measured));
            }
            break;
        }
        let rate = Rate::new(&counts, measured);
        let held = result
            .hold
            .is_some_and(|hold| rate.in_deadline_fraction >= hold);
        result.rates.push(rate);
        if !held {
            break;
        }
        result.knee_vehicles = Some(count);
        vehicles = (vehicles * GROWTH).ceil();
    }
    Ok(result)
}

impl fmt::Display for Ramp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:>8}{:>11}{:>11}{:>9}{:>9}{:>9}{:>9}{:>9}",
            "vehicles",
            "requests/s",
            "in time/s",
            "in time",
            "p50 ms",
            "p99 ms",
            "p99.9 ms",
            "lag p99"
        )?;
        for rate in &self.rates {
            writeln!(
                f,
                "{:8}{:11.1}{:11.1}{:8.2}%{:9.2}{:9.2}{:9.2}{:9.2}",
                rate.vehicles,
                rate.requests_per_second,
                rate.in_deadline_per_second,
                rate.in_deadline_fraction * 100.0,
                rate.latency_ms.p50,
                rate.latency_ms.p99,
                rate.latency_ms.p999,
                rate.generator_lag_ms.p99
            )?;
        }
        if self.interrupted {
            return write!(
                f,
                "interrupted: no further rate was measured, and the last one may be incomplete"
            );
        }
        match (self.hold, self.knee_vehicles) {
            (None, _) => write!(f, "one rate was measured; --ramp 0.99 looks for the knee"),
            (Some(hold), None) => write!(f, "no rate held {:.1} %", hold * 100.0),
            (Some(hold), Some(knee)) => {
                let hold = hold * 100.0;
                if self.rates.last().is_some_and(|rate| rate.vehicles == knee) {
                    write!(
                        f,
                        "every rate held {hold:.1} %: the knee is beyond {knee} vehicles; raise --most"
                    )
                } else {
                    write!(f, "{knee} vehicles is the most that held {hold:.1} %")
                }
            }
        }
    }
}
