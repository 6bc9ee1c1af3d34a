//! From the clock of a program to the time of day.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// How far apart two readings of a clock may be around a reading of the time of day; more means that the thread was
/// interrupted in between.
const CLOSE: Duration = Duration::from_micros(20);
const ATTEMPTS: usize = 8;

/// One moment on a clock that does not run backwards, and as the time of day. All times of a step's spans are converted with
/// the same one, so that their differences are those of the clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Time since the clock's own start.
    pub clock: Duration,
    /// Time since 1970-01-01 00:00 UTC.
    pub unix: Duration,
}

impl Moment {
    /// The present moment on this clock.
    pub fn now(clock: impl Fn() -> Duration) -> Self {
        let read = || {
            let before = clock();
            // A computer whose clock is set before 1970 has wrong times in any case.
            let unix = SystemTime::now()
                .duration_since(UNIX_EPOCH)
                .unwrap_or_default();
            let gap = clock().saturating_sub(before);
            let clock = before + gap / 2;
            (gap, Self { clock, unix })
        };
        let mut best = read();
        for _ in 1..ATTEMPTS {
            if best.0 <= CLOSE {
                break;
            }
            let next = read();
            if next.0 < best.0 {
                best = next;
            }
        }
        best.1
    }

    /// The time `at` of the clock as nanoseconds since 1970-01-01 00:00 UTC.
    pub fn unix_ns(&self, at: Duration) -> u64 {
        let unix = (self.unix + at).saturating_sub(self.clock);
        u64::try_from(unix.as_nanos()).unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::cell::Cell;
    use std::time::Instant;

    use super::*;

    #[test]
    fn times_before_and_after_the_moment_are_converted() {
        let moment = Moment {
            clock: Duration::from_secs(5),
            unix: Duration::from_secs(1_700_000_000),
        };
        let at = |ms| moment.unix_ns(Duration::from_millis(ms));
        assert_eq!(at(5_000), 1_700_000_000_000_000_000);
        assert_eq!(at(4_999), 1_699_999_999_999_000_000);
        assert_eq!(at(6_000), 1_700_000_001_000_000_000);
        assert_eq!(at(0), 1_699_999_995_000_000_000);
    }

    #[test]
    fn the_present_moment_is_the_time_of_day() {
        let start = Instant::now();
        let before = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        let moment = Moment::now(|| start.elapsed());
        let after = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        assert!((before..=after).contains(&moment.unix));
        assert!(moment.clock <= start.elapsed());
    }

    #[test]
    fn an_interrupted_reading_is_repeated() {
        // Each reading of the clock takes 1 ms, but the third one follows the second after 4 us.
        let (time, calls) = (Cell::new(Duration::ZERO), Cell::new(0));
        let clock = || {
            calls.set(calls.get() + 1);
            let step = if calls.get() == 4 { 4 } else { 1_000 };
            time.set(time.get() + Duration::from_micros(step));
            time.get()
        };
        let moment = Moment::now(clock);
        assert_eq!(moment.clock, Duration::from_micros(3_002));
        assert_eq!(calls.get(), 4);
    }
}
