//! The bounded queue between intake and workers: one slot per vehicle, earliest deadline first.
//!
//! A vehicle that asks again before it was served no longer needs the older answer, so its newest request takes the
//! slot; a vehicle that sends too many requests displaces only its own. Serving the earliest deadline first keeps late
//! requests from delaying the others.

use std::collections::{BTreeMap, HashMap};
use std::time::Instant;

use crate::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Orders the queue; the ticket separates equal deadlines.
type Place = (Instant, u64);

struct Waiting<T> {
    by_place: BTreeMap<Place, (String, T)>,
    slots: HashMap<String, Place>,
    tickets: u64,
    closed: bool,
}

/// Why an item was not queued; it is handed back.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Refused<T> {
    /// The largest number of vehicles wait already.
    Full(T),
    /// It would be served too late.
    Late(T),
    /// The queue is closed.
    Closed(T),
}

/// The outcome of a push.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Pushed<T> {
    /// The same vehicle's older item, which is removed even if the new item is not queued.
    pub(crate) superseded: Option<T>,
    /// Whether the new item waits now.
    pub(crate) queued: Result<(), Refused<T>>,
}

/// A queue of at most `capacity` vehicles.
pub(crate) struct Queue<T> {
    waiting: Mutex<Waiting<T>>,
    changed: Condvar,
    capacity: usize,
}

impl<T> Queue<T> {
    pub(crate) fn new(capacity: usize) -> Self {
        let waiting = Waiting {
            by_place: BTreeMap::new(),
            slots: HashMap::new(),
            tickets: 0,
            closed: false,
        };
        Self {
            waiting: Mutex::new(waiting),
            changed: Condvar::new(),
            capacity,
        }
    }

    /// Offers an item. `in_time` gets the number of items with an earlier deadline and decides on admission.
    pub(crate) fn push(
        &self,
        vehicle: String,
        deadline: Instant,
        item: T,
        in_time: impl FnOnce(usize) -> bool,
    ) -> Pushed<T> {
        let mut waiting = self.lock();
        let old = waiting.slots.remove(&vehicle);
        let superseded = old
            .and_then(|place| waiting.by_place.remove(&place))
            .map(|(_, item)| item);
        let place = (deadline, waiting.tickets);
        let queued = if waiting.closed {
            Err(Refused::Closed(item))
        } else if waiting.slots.len() >= self.capacity {
            Err(Refused::Full(item))
        } else if !in_time(waiting.by_place.range(..place).count()) {
            Err(Refused::Late(item))
        } else {
            waiting.tickets += 1;
            waiting.slots.insert(vehicle.clone(), place);
            waiting.by_place.insert(place, (vehicle, item));
            self.changed.notify_one();
            Ok(())
        };
        Pushed { superseded, queued }
    }

    /// Waits for an item and returns that with the earliest deadline, or `None` once the queue is closed and empty.
    pub(crate) fn pop(&self) -> Option<T> {
        let mut waiting = self.lock();
        loop {
            if let Some(item) = Self::take_first(&mut waiting) {
                return Some(item);
            }
            if waiting.closed {
                return None;
            }
            waiting = self
                .changed
                .wait(waiting)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The item with the earliest deadline, or `None` if the queue is empty.
    pub(crate) fn try_pop(&self) -> Option<T> {
        Self::take_first(&mut self.lock())
    }

    fn take_first(waiting: &mut Waiting<T>) -> Option<T> {
        let (_, (vehicle, item)) = waiting.by_place.pop_first()?;
        waiting.slots.remove(&vehicle);
        Some(item)
    }

    /// Closes the queue: later items are handed back, those that wait are still served.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    /// Vehicles that wait.
    pub(crate) fn len(&self) -> usize {
        self.lock().slots.len()
    }

    /// A panic cannot leave the data half changed, so a poisoned lock is used like any other.
    fn lock(&self) -> MutexGuard<'_, Waiting<T>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn at(start: Instant, ms: u64) -> Instant {
        start + Duration::from_millis(ms)
    }

    const FITS: fn(usize) -> bool = |_| true;

    #[test]
    fn the_earliest_deadline_is_served_first() {
        let (queue, start) = (Queue::new(8), Instant::now());
        for (vehicle, ms) in [("a", 30), ("b", 10), ("c", 20)] {
            queue.push(vehicle.to_owned(), at(start, ms), vehicle, FITS);
        }
        assert_eq!(
            [queue.pop(), queue.pop(), queue.pop()],
            [Some("b"), Some("c"), Some("a")]
        );
    }

    #[test]
    fn equal_deadlines_are_served_in_the_order_of_arrival() {
        let (queue, start) = (Queue::new(8), Instant::now());
        for vehicle in ["c", "a", "b"] {
            queue.push(vehicle.to_owned(), start, vehicle, FITS);
        }
        assert_eq!(queue.len(), 3);
        let order = std::iter::from_fn(|| queue.try_pop());
        assert_eq!(order.collect::<Vec<_>>(), ["c", "a", "b"]);
    }

    #[test]
    fn the_newest_request_of_a_vehicle_takes_its_slot() {
        let (queue, start) = (Queue::new(1), Instant::now());
        let push = |item| queue.push("a".to_owned(), at(start, item), item, FITS);
        push(1);
        assert_eq!(
            push(2),
            Pushed {
                superseded: Some(1),
                queued: Ok(())
            }
        );
        assert_eq!(queue.len(), 1);
        assert_eq!(queue.pop(), Some(2));
    }

    #[test]
    fn a_full_queue_refuses_other_vehicles_only() {
        let (queue, start) = (Queue::new(1), Instant::now());
        queue.push("a".to_owned(), start, 1, FITS);
        let other = queue.push("b".to_owned(), start, 2, FITS);
        assert_eq!(other.queued, Err(Refused::Full(2)));
        assert_eq!(queue.push("a".to_owned(), start, 3, FITS).queued, Ok(()));
    }

    #[test]
    fn admission_sees_those_with_earlier_deadlines() {
        let (queue, start) = (Queue::new(8), Instant::now());
        for (vehicle, ms) in [("a", 10), ("b", 20), ("c", 40)] {
            queue.push(vehicle.to_owned(), at(start, ms), vehicle, FITS);
        }
        let mut ahead = 0;
        let refuse = |count| {
            ahead = count;
            false
        };
        let pushed = queue.push("d".to_owned(), at(start, 30), "d", refuse);
        assert_eq!((ahead, pushed.queued), (2, Err(Refused::Late("d"))));
    }

    #[test]
    fn a_closed_queue_empties_and_ends() {
        let (queue, start) = (Queue::new(8), Instant::now());
        queue.push("a".to_owned(), start, 1, FITS);
        queue.close();
        assert_eq!(
            queue.push("b".to_owned(), start, 2, FITS).queued,
            Err(Refused::Closed(2))
        );
        assert_eq!((queue.pop(), queue.pop()), (Some(1), None));
    }
}
