//! When vehicles were served, and how urgent their next requests are.

use std::collections::HashMap;
use std::time::{Duration, Instant};

/// Least time between the deadlines of two requests of a vehicle, by which the queue is ordered; stated budgets may be shorter.
const LEAST_BUDGET: Duration = Duration::from_millis(4);
/// Time by which the queue treats a request as less urgent than it is, at most.
const MOST_DELAY: Duration = Duration::from_millis(100);
/// Vehicles whose turns are remembered; beyond that number all turns are forgotten, so that senders that invent names fill
/// a bounded part of the memory.
const REMEMBERED: usize = 8192;

/// When a vehicle was served.
#[derive(Clone, Copy)]
pub(crate) struct Turn {
    /// Counted in requests that were served.
    pub(crate) number: u64,
    /// The deadline by which the queue had ordered its request; none if it was not served yet.
    deadline: Option<Instant>,
}

impl Turn {
    /// The deadline by which the queue orders the vehicle's next request.
    ///
    /// It is that of a constant bandwidth server (Abeni and Buttazzo, "Integrating multimedia applications in hard real-time
    /// systems", IEEE Real-Time Systems Symposium, 1998): at least one budget after the deadline of the vehicle's last request
    /// that was served. For a vehicle that asks no more often than once in a budget this is the deadline itself.
    pub(crate) fn in_order(self, arrived: Instant, deadline: Instant) -> Instant {
        let budget = (deadline - arrived).max(LEAST_BUDGET);
        let next = self.deadline.map_or(deadline, |last| last + budget);
        next.clamp(deadline, deadline + MOST_DELAY)
    }
}

/// When each vehicle was served.
#[derive(Default)]
pub(crate) struct Served {
    turns: HashMap<String, Turn>,
    /// Requests that were served.
    count: u64,
}

impl Served {
    /// When the vehicle was served. One that is new counts as served just now, so that a sender gains nothing by new names.
    pub(crate) fn turn(&mut self, vehicle: &str) -> Turn {
        if let Some(turn) = self.turns.get(vehicle) {
            return *turn;
        }
        if self.turns.len() >= REMEMBERED {
            self.turns.clear();
        }
        let new = Turn {
            number: self.count,
            deadline: None,
        };
        self.turns.insert(vehicle.to_owned(), new);
        new
    }

    /// The number of the vehicle's turn.
    pub(crate) fn number(&self, vehicle: &str) -> u64 {
        self.turns
            .get(vehicle)
            .map_or(self.count, |turn| turn.number)
    }

    /// A request of the vehicle is served, which the queue had ordered by this deadline.
    pub(crate) fn note(&mut self, vehicle: String, deadline: Instant) {
        self.count += 1;
        let turn = Turn {
            number: self.count,
            deadline: Some(deadline),
        };
        self.turns.insert(vehicle, turn);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_that_asks_once_in_a_budget_has_its_own_deadline() {
        let start = Instant::now();
        let mut served = Served::default();
        for period in 0..100 {
            let arrived = start + Duration::from_millis(20) * period;
            let deadline = arrived + Duration::from_millis(16);
            let ordered = served.turn("a").in_order(arrived, deadline);
            assert_eq!(ordered, deadline);
            served.note("a".to_owned(), ordered);
        }
    }

    #[test]
    fn the_names_that_are_remembered_are_bounded() {
        let mut served = Served::default();
        for name in 0..=REMEMBERED {
            served.turn(&name.to_string());
            assert!(served.turns.len() <= REMEMBERED);
        }
        assert_eq!(served.turns.len(), 1);
    }
}
