//! The queue between threads that push and threads that take out.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use crate::queue::{Pushed, Queue, Refused};
use crate::sync::{Arc, mpsc, thread};

/// An item: the index of the thread that pushed it, its number there, and its deadline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Item {
    by: usize,
    number: usize,
    deadline: Instant,
}

impl Item {
    /// Whether the vehicle is the same: the threads 0 and 1 push for one vehicle.
    fn is_of_vehicle_of(&self, other: &Self) -> bool {
        (self.by < 2) == (other.by < 2)
    }
}

/// What happened to an item. Calls are numbered at their beginning and end, so that it can be told which call ended before
/// another began.
#[derive(Debug)]
enum Event {
    Queued(Item, Call),
    Refused(Item),
    Popped(Item, Call),
    /// Removed by the second item, which is of the same vehicle.
    Superseded(Item, Item, Call),
    /// Removed by the second item, which is of another vehicle, because the queue was full.
    Displaced(Item, Item, Call),
}

/// Beginning and end of a call.
#[derive(Clone, Copy, Debug)]
struct Call(usize, usize);

/// All events, and the number of the next beginning or end. Its lock is none of shuttle's, so that it adds no interleavings.
#[derive(Default)]
struct Log(Mutex<(usize, Vec<Event>)>);

impl Log {
    fn tick(&self) -> usize {
        let mut log = self.0.lock().unwrap();
        log.0 += 1;
        log.0
    }

    fn note(&self, event: Event) {
        self.0.lock().unwrap().1.push(event);
    }
}

/// Two threads that push for one vehicle and one for another, and two that take out until the queue is closed. Each item
/// ends in one way, vehicles do not exceed the capacity, the newest item of a vehicle stays, and the earliest deadline comes
/// first.
pub fn items_end_once_and_in_order(capacity: usize) {
    let (queue, log) = (Arc::new(Queue::new(capacity)), Arc::new(Log::default()));
    let start = Instant::now();
    let pushing: Vec<_> = [("a", vec![30, 10]), ("a", vec![20]), ("b", vec![25, 5])]
        .into_iter()
        .enumerate()
        .map(|(by, (vehicle, deadlines))| {
            let (queue, log) = (queue.clone(), log.clone());
            thread::spawn(move || {
                for (number, ms) in deadlines.into_iter().enumerate() {
                    let deadline = start + Duration::from_millis(ms);
                    let item = Item {
                        by,
                        number,
                        deadline,
                    };
                    push(&queue, &log, vehicle, item, capacity);
                }
            })
        })
        .collect();
    let taking: Vec<_> = (0..2)
        .map(|_| {
            let (queue, log) = (queue.clone(), log.clone());
            thread::spawn(move || {
                loop {
                    let begin = log.tick();
                    let Some(item) = queue.pop() else { break };
                    log.note(Event::Popped(item, Call(begin, log.tick())));
                }
            })
        })
        .collect();
    for thread in pushing {
        thread.join().unwrap();
    }
    queue.close();
    for thread in taking {
        thread.join().unwrap();
    }
    assert_eq!(queue.len(), 0);
    let (_, events) = std::mem::take(&mut *log.0.lock().unwrap());
    check_ends(&events);
    check_order(&events);
}

fn push(queue: &Queue<Item>, log: &Log, vehicle: &str, item: Item, capacity: usize) {
    let begin = log.tick();
    let Pushed {
        superseded,
        displaced,
        queued,
    } = queue.push(vehicle.to_owned(), item.deadline, item, |_| true);
    let call = Call(begin, log.tick());
    if let Some(old) = superseded {
        log.note(Event::Superseded(old, item, call));
    }
    match displaced {
        None => {}
        Some(Refused::Full(other)) => {
            assert!(capacity < 2, "{other:?} keeps its place beside one vehicle");
            log.note(Event::Displaced(other, item, call));
        }
        Some(other) => unreachable!("{other:?}"),
    }
    match queued {
        Ok(()) => log.note(Event::Queued(item, call)),
        Err(Refused::Full(item)) => {
            assert!(capacity < 2, "{item:?} has no place beside one vehicle");
            log.note(Event::Refused(item));
        }
        Err(other) => unreachable!("{other:?}"),
    }
    assert!(queue.len() <= capacity);
}

/// Each item that was queued was removed once, and those of one thread in the order in which they were pushed.
fn check_ends(events: &[Event]) {
    let queued = events.iter().filter_map(|event| match event {
        Event::Queued(item, _) => Some(*item),
        _ => None,
    });
    let removed: Vec<_> = events.iter().filter_map(removal).collect();
    for item in queued {
        let ends = removed.iter().filter(|(other, _)| *other == item).count();
        assert_eq!(ends, 1, "{item:?} was removed {ends} times: {events:?}");
    }
    assert_eq!(
        events
            .iter()
            .filter(|event| matches!(event, Event::Refused(_) | Event::Queued(..)))
            .count(),
        5
    );
    for (index, (item, Call(begin, _))) in removed.iter().enumerate() {
        for (older, Call(_, end)) in &removed[..index] {
            let newer_first = older.by == item.by && older.number > item.number && end < begin;
            assert!(!newer_first, "{item:?} after {older:?}: {events:?}");
        }
    }
    for event in events {
        match event {
            Event::Superseded(old, by, _) => {
                assert!(old.is_of_vehicle_of(by), "{event:?}");
                assert!(old.by != by.by || old.number < by.number, "{event:?}");
            }
            Event::Displaced(old, by, Call(_, end)) => {
                assert!(!old.is_of_vehicle_of(by), "{event:?}");
                let served = events.iter().any(|event| {
                    matches!(event, Event::Popped(last, Call(begin, _))
                        if last.is_of_vehicle_of(old) && begin < end)
                });
                assert!(
                    served,
                    "{event:?} before its vehicle was served: {events:?}"
                );
            }
            Event::Queued(..) | Event::Refused(_) | Event::Popped(..) => {}
        }
    }
}

/// No item was popped while one with an earlier deadline waited from before the call until after it, unless an item of the
/// latter one's vehicle had been popped before: it is then less urgent than its deadline.
fn check_order(events: &[Event]) {
    for event in events {
        let Event::Popped(item, Call(begin, end)) = event else {
            continue;
        };
        for other in events {
            let Event::Queued(earlier, Call(_, queued)) = other else {
                continue;
            };
            let waited = queued < begin
                && events
                    .iter()
                    .filter_map(removal)
                    .any(|(removed, Call(removal, _))| removed == *earlier && removal > *end);
            let served = events.iter().any(|event| {
                matches!(event, Event::Popped(last, Call(begin, _))
                    if last.is_of_vehicle_of(earlier) && begin < queued)
            });
            assert!(
                !waited || served || item.deadline <= earlier.deadline,
                "{item:?} was popped before {earlier:?}: {events:?}"
            );
        }
    }
}

fn removal(event: &Event) -> Option<(Item, Call)> {
    match event {
        Event::Popped(item, call)
        | Event::Superseded(item, _, call)
        | Event::Displaced(item, _, call) => Some((*item, *call)),
        Event::Queued(..) | Event::Refused(_) => None,
    }
}

/// Three threads push an item each and wait until one of two other threads has taken it out. The queue is closed only
/// afterwards, so that a thread that is not woken waits for ever.
pub fn no_thread_sleeps_while_an_item_waits() {
    let queue = Arc::new(Queue::new(3));
    let start = Instant::now();
    let pushing: Vec<_> = ["a", "b", "c"]
        .into_iter()
        .map(|vehicle| {
            let queue = queue.clone();
            thread::spawn(move || {
                let (done, taken) = mpsc::channel::<()>();
                let pushed = queue.push(vehicle.to_owned(), start, done, |_| true);
                assert!(pushed.queued.is_ok());
                taken.recv().unwrap();
            })
        })
        .collect();
    let taking: Vec<_> = (0..2)
        .map(|_| {
            let queue = queue.clone();
            thread::spawn(move || {
                while let Some(done) = queue.pop() {
                    done.send(()).unwrap();
                }
            })
        })
        .collect();
    for thread in pushing {
        thread.join().unwrap();
    }
    queue.close();
    for thread in taking {
        thread.join().unwrap();
    }
}
