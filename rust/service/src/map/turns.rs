//! The queries that wait for the keeper. Vehicles have one each in turn, so that a query waits for one answer to each other
//! vehicle at most, however many queries that vehicle sent.

use std::collections::{HashMap, VecDeque};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use egp_wire::keys::Name;

/// Fleet and name of a vehicle.
pub(crate) type Vehicle = (Name, Name);

/// Why an item does not wait; it is handed back.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Refused<T> {
    /// The largest number of items of its vehicle wait already.
    Vehicle(T),
    /// The largest number of items of all vehicles wait already.
    All(T),
    /// Nothing is taken any more.
    Closed(T),
}

/// What the keeper does next.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Next<T> {
    /// It handles this item.
    Item(T),
    /// No item came within the patience, or before it was woken.
    Nothing,
    /// It ends: nothing waits, and nothing will come.
    End,
}

struct Waiting<T> {
    /// The items of each vehicle that has some, the oldest first.
    items: HashMap<Vehicle, VecDeque<T>>,
    /// These vehicles, the one whose turn is next first.
    order: VecDeque<Vehicle>,
    count: usize,
    woken: bool,
    closed: bool,
}

/// Items of vehicles, at most `each` of one vehicle and `all` in sum.
pub(crate) struct Turns<T> {
    waiting: Mutex<Waiting<T>>,
    changed: Condvar,
    each: usize,
    all: usize,
}

impl<T> Turns<T> {
    pub(crate) fn new(each: usize, all: usize) -> Self {
        let waiting = Waiting {
            items: HashMap::new(),
            order: VecDeque::new(),
            count: 0,
            woken: false,
            closed: false,
        };
        Self {
            waiting: Mutex::new(waiting),
            changed: Condvar::new(),
            each,
            all,
        }
    }

    /// Lets an item of a vehicle wait behind the vehicle's other ones.
    pub(crate) fn push(&self, vehicle: Vehicle, item: T) -> Result<(), Refused<T>> {
        let mut waiting = self.lock();
        let own = waiting.items.get(&vehicle).map_or(0, VecDeque::len);
        if waiting.closed {
            return Err(Refused::Closed(item));
        }
        if own >= self.each {
            return Err(Refused::Vehicle(item));
        }
        if waiting.count >= self.all {
            return Err(Refused::All(item));
        }
        waiting.count += 1;
        if own == 0 {
            waiting.order.push_back(vehicle.clone());
        }
        waiting.items.entry(vehicle).or_default().push_back(item);
        self.changed.notify_one();
        Ok(())
    }

    /// The oldest item of the vehicle whose turn it is, for which it waits up to `patience`.
    pub(crate) fn next(&self, patience: Duration) -> Next<T> {
        let (mut waiting, begun) = (self.lock(), Instant::now());
        loop {
            if let Some(item) = take(&mut waiting) {
                return Next::Item(item);
            }
            if waiting.closed {
                return Next::End;
            }
            let left = patience.saturating_sub(begun.elapsed());
            if std::mem::take(&mut waiting.woken) || left.is_zero() {
                return Next::Nothing;
            }
            let waited = self.changed.wait_timeout(waiting, left);
            waiting = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Lets the call of [`Turns::next`] that waits, or else the next one that would wait, return at once.
    pub(crate) fn wake(&self) {
        self.lock().woken = true;
        self.changed.notify_one();
    }

    /// Takes no further items; those that wait are still handed out.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_one();
    }

    /// Whether no further items are taken.
    pub(crate) fn is_closed(&self) -> bool {
        self.lock().closed
    }

    fn lock(&self) -> MutexGuard<'_, Waiting<T>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn take<T>(waiting: &mut Waiting<T>) -> Option<T> {
    let vehicle = waiting.order.pop_front()?;
    let items = waiting.items.get_mut(&vehicle)?;
    let item = items.pop_front()?;
    waiting.count -= 1;
    if items.is_empty() {
        waiting.items.remove(&vehicle);
    } else {
        waiting.order.push_back(vehicle);
    }
    Some(item)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::thread;

    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    fn vehicle(name: &str) -> Vehicle {
        ("depot".parse().unwrap(), name.parse().unwrap())
    }

    #[test]
    fn vehicles_have_one_item_each_in_turn() {
        let turns = Turns::new(64, 1024);
        for item in 0..64 {
            turns.push(vehicle("flood"), item).unwrap();
        }
        let got = |item| assert_eq!(turns.next(HOUR), Next::Item(item));
        got(0);
        turns.push(vehicle("b"), 100).unwrap();
        turns.push(vehicle("b"), 101).unwrap();
        turns.push(vehicle("c"), 200).unwrap();
        for item in [1, 100, 200, 2, 101, 3, 4] {
            got(item);
        }
        turns.push(vehicle("b"), 102).unwrap();
        got(5);
        got(102);
    }

    #[test]
    fn what_waits_is_bounded_for_each_vehicle_and_for_all() {
        let turns = Turns::new(2, 3);
        for item in 0..2 {
            turns.push(vehicle("a"), item).unwrap();
        }
        assert_eq!(turns.push(vehicle("a"), 2), Err(Refused::Vehicle(2)));
        turns.push(vehicle("b"), 3).unwrap();
        assert_eq!(turns.push(vehicle("b"), 4), Err(Refused::All(4)));
        assert_eq!(turns.next(HOUR), Next::Item(0));
        turns.push(vehicle("b"), 4).unwrap();
        turns.close();
        assert_eq!(turns.push(vehicle("c"), 5), Err(Refused::Closed(5)));
        for item in [3, 1, 4] {
            assert_eq!(turns.next(HOUR), Next::Item(item));
        }
        assert_eq!(turns.next(HOUR), Next::End);
    }

    #[test]
    fn the_keeper_waits_for_an_item_until_it_is_woken() {
        let turns = Turns::new(2, 3);
        assert_eq!(turns.next(Duration::ZERO), Next::<u8>::Nothing);
        // A call that comes before the wait is not lost.
        turns.wake();
        assert_eq!(turns.next(HOUR), Next::Nothing);
        thread::scope(|scope| {
            for step in 0..3 {
                let waiting = scope.spawn(|| turns.next(HOUR));
                match step {
                    0 => turns.wake(),
                    1 => turns.push(vehicle("a"), 7).unwrap(),
                    _ => turns.close(),
                }
                let next = [Next::Nothing, Next::Item(7), Next::End];
                assert_eq!(waiting.join().unwrap(), next[step]);
            }
        });
    }
}
