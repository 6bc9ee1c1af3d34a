//! The bounded queue between intake and workers: one slot per vehicle, earliest deadline first.
//!
//! A vehicle that asks again before it was served no longer needs the older answer, so its newest request takes the
//! slot; a vehicle that sends too many requests displaces only its own. Serving the earliest deadline first keeps late
//! requests from delaying the others. If not all can be served, or if the queue is full, vehicles take turns: the request of
//! a vehicle that was served longer ago takes the place of one whose vehicle was served last. The order is that of
//! `Turn::ordering_deadline`, because a vehicle that always asks again at once would otherwise always be first.

use std::collections::{BTreeMap, HashMap};
use std::time::Instant;

use crate::served::Served;
use crate::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Orders the queue; the ticket separates equal deadlines.
type Place = (Instant, u64);

struct Waiting<T> {
    by_place: BTreeMap<Place, (String, T)>,
    slots: HashMap<String, Place>,
    tickets: u64,
    served: Served,
    closed: bool,
}

impl<T> Waiting<T> {
    /// The place of the item whose vehicle was served last, of those before `end` if there is one; none if no vehicle of these
    /// was served after `turn`.
    fn served_after(&self, turn: u64, end: Option<Place>) -> Option<Place> {
        let turns = self
            .by_place
            .iter()
            .take_while(|(place, _)| end.is_none_or(|end| **place < end))
            .map(|(place, (vehicle, _))| (self.served.number(vehicle), *place));
        turns
            .max()
            .filter(|(last, _)| *last > turn)
            .map(|(_, place)| place)
    }

    fn remove(&mut self, place: Place) -> Option<T> {
        let (vehicle, item) = self.by_place.remove(&place)?;
        self.slots.remove(&vehicle);
        Some(item)
    }
}

/// Why an item was not queued; it is handed back.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Refused<T> {
    /// The largest number of vehicles wait already, and none of them was served after this one.
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
    /// The item of another vehicle, which had been served after this one, that gave up its place, and why.
    pub(crate) displaced: Option<Refused<T>>,
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
            served: Served::default(),
            closed: false,
        };
        Self {
            waiting: Mutex::new(waiting),
            changed: Condvar::new(),
            capacity,
        }
    }

    /// Offers an item. `in_time` gets the number of items that are served before it and decides on admission.
    pub(crate) fn push(
        &self,
        vehicle: String,
        deadline: Instant,
        item: T,
        in_time: impl Fn(usize) -> bool,
    ) -> Pushed<T> {
        let mut waiting = self.lock();
        let old = waiting.slots.get(&vehicle).copied();
        let superseded = old.and_then(|place| waiting.remove(place));
        let turn = waiting.served.turn(&vehicle);
        let place = (turn.ordering_deadline(deadline), waiting.tickets);
        let ahead = waiting.by_place.range(..place).count();
        let mut displaced = None;
        let queued = if waiting.closed {
            Err(Refused::Closed(item))
        } else {
            let full = waiting.slots.len() >= self.capacity;
            let late = !in_time(ahead);
            let reason = if full { Refused::Full } else { Refused::Late };
            if full || late {
                // Only a place before this one makes a late request earlier.
                displaced = waiting
                    .served_after(turn.number, late.then_some(place))
                    .filter(|_| !late || in_time(ahead - 1))
                    .and_then(|other| waiting.remove(other))
                    .map(reason);
            }
            if (full || late) && displaced.is_none() {
                Err(reason(item))
            } else {
                waiting.tickets += 1;
                waiting.slots.insert(vehicle.clone(), place);
                waiting.by_place.insert(place, (vehicle, item));
                Ok(())
            }
        };
        // A worker that is woken needs the lock at once.
        drop(waiting);
        if queued.is_ok() {
            self.changed.notify_one();
        }
        Pushed {
            superseded,
            displaced,
            queued,
        }
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
        let ((deadline, _), (vehicle, item)) = waiting.by_place.pop_first()?;
        waiting.slots.remove(&vehicle);
        waiting.served.note(vehicle, deadline);
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
    use std::cell::Cell;
    use std::time::Duration;

    use super::Refused::{Full, Late};
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
                displaced: None,
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
        assert_eq!(other.queued, Err(Full(2)));
        assert_eq!(queue.push("a".to_owned(), start, 3, FITS).queued, Ok(()));
    }

    #[test]
    fn admission_sees_those_with_earlier_deadlines() {
        let (queue, start) = (Queue::new(8), Instant::now());
        for (vehicle, ms) in [("a", 10), ("b", 20), ("c", 40)] {
            queue.push(vehicle.to_owned(), at(start, ms), vehicle, FITS);
        }
        let ahead = Cell::new(0);
        let refuse = |count| {
            ahead.set(count);
            false
        };
        let pushed = queue.push("d".to_owned(), at(start, 30), "d", refuse);
        assert_eq!((ahead.get(), pushed.queued), (2, Err(Late("d"))));
    }

    /// A queue that served `a`, `b` and `c` in this order.
    fn served(start: Instant, capacity: usize) -> Queue<&'static str> {
        let queue = Queue::new(capacity);
        for vehicle in ["a", "b", "c"] {
            queue.push(vehicle.to_owned(), start, vehicle, FITS);
            queue.pop();
        }
        queue
    }

    #[test]
    fn a_vehicle_that_was_served_earlier_takes_the_place_of_the_one_served_last() {
        let start = Instant::now();
        let queue = served(start, 8);
        let push = |vehicle: &'static str, ms| {
            queue.push(vehicle.to_owned(), at(start, ms), vehicle, |ahead| {
                ahead < 2
            })
        };
        push("c", 10);
        push("b", 20);
        let pushed = push("a", 30);
        assert_eq!((pushed.displaced, pushed.queued), (Some(Late("c")), Ok(())));
        // Of those that wait, none was served after it.
        let pushed = push("c", 40);
        assert_eq!((pushed.displaced, pushed.queued), (None, Err(Late("c"))));
        assert_eq!(
            [queue.pop(), queue.pop(), queue.try_pop()],
            [Some("b"), Some("a"), None]
        );
        assert_eq!(queue.len(), 0);
    }

    #[test]
    fn in_a_full_queue_it_takes_a_place_behind_its_own_as_well() {
        let start = Instant::now();
        let queue = served(start, 2);
        let push = |vehicle, ms| queue.push(String::from(vehicle), at(start, ms), vehicle, FITS);
        push("b", 10);
        push("c", 30);
        assert_eq!(push("a", 20).displaced, Some(Full("c")));
        assert_eq!(push("c", 5).queued, Err(Full("c")));
        assert_eq!([queue.pop(), queue.pop()], [Some("b"), Some("a")]);
    }

    #[test]
    fn nothing_gives_up_its_place_for_a_request_that_is_late_nevertheless() {
        let start = Instant::now();
        let queue = served(start, 8);
        queue.push("c".to_owned(), at(start, 10), "c", FITS);
        let pushed = queue.push("a".to_owned(), at(start, 20), "a", |_| false);
        assert_eq!((pushed.displaced, pushed.queued), (None, Err(Late("a"))));
        assert_eq!(queue.pop(), Some("c"));
    }

    #[test]
    fn a_new_name_has_no_turn_before_others() {
        let start = Instant::now();
        let queue = served(start, 8);
        queue.push("a".to_owned(), at(start, 10), "a", FITS);
        let alone = |ahead| ahead < 1;
        for vehicle in ["new", "other"] {
            let pushed = queue.push(vehicle.to_owned(), at(start, 20), vehicle, alone);
            assert_eq!(
                (pushed.displaced, pushed.queued),
                (None, Err(Late(vehicle)))
            );
        }
        // It is remembered from its first request on, so its turn comes when others have been served.
        queue.pop();
        queue.push("b".to_owned(), at(start, 20), "b", FITS);
        queue.pop();
        queue.push("b".to_owned(), at(start, 20), "b", FITS);
        let pushed = queue.push("new".to_owned(), at(start, 30), "new", alone);
        assert_eq!((pushed.displaced, pushed.queued), (Some(Late("b")), Ok(())));
    }

    #[test]
    fn a_vehicle_that_asks_at_once_again_with_short_budgets_does_not_come_before_all_others() {
        let micros = Duration::from_micros;
        let cars = ["a", "b", "c", "d", "e", "f", "g", "h"];
        for budget in [micros(1), micros(300), micros(2_000), micros(8_000)] {
            let (queue, start) = (Queue::new(16), Instant::now());
            // One worker, whose steps take 250 µs. It is never idle, because the flood asks after each of them.
            let (mut waited, mut flooded) = (Vec::new(), 0);
            for step in 0..800 {
                let now = start + step * micros(250);
                // The cars ask once in 20 ms, all at once.
                for car in cars.iter().filter(|_| step % 80 == 0) {
                    let item = Some(now);
                    queue.push((*car).to_owned(), now + micros(16_000), item, FITS);
                }
                queue.push("flood".to_owned(), now + budget, None, FITS);
                match queue.try_pop() {
                    Some(Some(arrived)) => waited.push(now - arrived),
                    _ => flooded += 1,
                }
            }
            assert_eq!((waited.len(), flooded), (80, 720), "{budget:?}");
            let longest = waited.iter().max().copied();
            assert!(longest < Some(micros(4_000)), "{budget:?}: {longest:?}");
        }
    }

    #[test]
    fn a_request_is_deferred_by_a_tenth_of_a_second_at_most() {
        let (queue, start) = (Queue::new(8), Instant::now());
        for _ in 0..1000 {
            queue.push("a".to_owned(), at(start, 16), "a", FITS);
            queue.pop();
        }
        for (vehicle, ms) in [("a", 16), ("b", 115), ("c", 117)] {
            queue.push(vehicle.to_owned(), at(start, ms), vehicle, FITS);
        }
        let order = std::iter::from_fn(|| queue.try_pop());
        assert_eq!(order.collect::<Vec<_>>(), ["b", "a", "c"]);
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
