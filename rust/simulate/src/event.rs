//! What happens in virtual time, in order.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::time::Duration;

use egp_driver::QueryId;

use crate::fault::Fault;
use crate::library::File;
use crate::replica::Exchange;
use crate::router::{Attempt, Node};

/// What a network delivers to a vehicle for one of its queries.
#[derive(Clone, Debug)]
pub(crate) enum Message {
    /// A reply's payload and attachment.
    Reply(Vec<u8>, Vec<u8>),
    /// An error's payload.
    Error(Vec<u8>),
    /// The end of the query.
    End,
}

/// An event; indices are those of vehicles and replicas.
pub(crate) enum Event {
    /// A control period of a vehicle begins.
    Period(usize),
    /// A vehicle's driver is due to wake.
    Wake(usize),
    /// A query reaches a replica, if the replica is still in this incarnation.
    Arrive(usize, u32, Exchange),
    /// An idle worker of a replica wakes.
    Work(usize, u32),
    /// The step of a replica's worker has taken its time.
    StepEnds(usize, u32, usize),
    /// A message reaches a vehicle.
    Deliver(usize, QueryId, Message),
    /// A replica's liveliness token appears to a vehicle, or is lost.
    Token(usize, usize, bool),
    /// A fault begins, and lasts so long.
    Begin(Fault, Duration),
    /// A fault ends.
    Finish(Fault),
    /// A frozen process of a replica continues, if the replica is still in this incarnation.
    Thaw(usize, u32),
    /// A drained replica stops receiving queries.
    Undeclare(usize, u32),
    /// A replica starts.
    Start(usize),
    /// A request of a flood.
    Flood(usize, u32),
    /// A replica in this incarnation has read and checked its library file.
    Loaded(usize, u32, File),
    /// A vehicle or a replica tries to connect to a router.
    Connect(Attempt),
    /// The lease of a link to a router has passed, if the router has stood still since this turn.
    Lease(Node, usize, u32),
    /// A router begins to listen.
    StartRouter(usize),
}

struct Entry {
    due: Reverse<(Duration, u64)>,
    event: Event,
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.due == other.due
    }
}
impl Eq for Entry {}
impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Entry {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.due.cmp(&other.due)
    }
}

/// Events by time; of those at the same time, the one that was added first.
#[derive(Default)]
pub(crate) struct Agenda {
    entries: BinaryHeap<Entry>,
    added: u64,
}

impl Agenda {
    pub(crate) fn add(&mut self, due: Duration, event: Event) {
        self.added += 1;
        self.entries.push(Entry {
            due: Reverse((due, self.added)),
            event,
        });
    }

    pub(crate) fn next(&mut self) -> Option<(Duration, Event)> {
        let Entry { due, event } = self.entries.pop()?;
        Some((due.0.0, event))
    }

    pub(crate) fn len(&self) -> usize {
        self.entries.len()
    }
}
