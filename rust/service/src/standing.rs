//! Whether requests wait although the queue had time to empty.
//!
//! A queue evens out requests that come at once. If it never becomes short, there are more requests than the workers can
//! answer, and a long queue only makes the answers that are given late: each then spends most of its budget on waiting, and
//! nothing is left for the network and for processors, which are busy then, too. Nichols and Jacobson, "Controlling queue
//! delay", ACM Queue 10(5), 2012, distinguish the two kinds of queue in the same way.

use std::time::{Duration, Instant};

use crate::sync::{Mutex, MutexGuard, PoisonError};

/// A queue that was not short for this time is a standing one; several control periods.
const PATIENCE: Duration = Duration::from_millis(100);

/// Whether the queue is a standing one, by the time at which it was last short.
#[derive(Default)]
pub(crate) struct Standing {
    short: Mutex<Option<Instant>>,
}

impl Standing {
    /// The queue is short at the time `now`.
    pub(crate) fn note_short(&self, now: Instant) {
        *self.lock() = Some(now);
    }

    /// Whether the queue was not short for a while until `now`. At the first call it counts as short.
    pub(crate) fn is_standing(&self, now: Instant) -> bool {
        let since = *self.lock().get_or_insert(now);
        now.saturating_duration_since(since) > PATIENCE
    }

    fn lock(&self) -> MutexGuard<'_, Option<Instant>> {
        self.short.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::query::recorded::at;

    #[test]
    fn a_queue_stands_if_it_was_not_short_for_a_while() {
        let (standing, start) = (Standing::default(), Instant::now());
        assert!(!standing.is_standing(at(start, 500.0)));
        assert!(!standing.is_standing(at(start, 600.0)));
        assert!(standing.is_standing(at(start, 600.1)));
        standing.note_short(at(start, 650.0));
        assert!(!standing.is_standing(at(start, 750.0)));
        assert!(standing.is_standing(at(start, 750.1)));
    }
}
