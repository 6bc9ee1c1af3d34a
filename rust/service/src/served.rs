//! When vehicles were served, and how urgent their next requests are.

use std::collections::HashMap;
use std::time::{Duration, Instant};

/// Least time between two requests of a vehicle in the order of the queue, whatever deadlines they state.
const SPACING: Duration = Duration::from_millis(4);
/// Longest time by which the order of the queue defers a request behind its deadline.
const LONGEST_DEFERRAL: Duration = Duration::from_millis(100);
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
    /// systems", IEEE Real-Time Systems Symposium, 1998) with a period of `SPACING`: the request's own deadline, or `SPACING`
    /// after the ordering deadline of the vehicle's last served request if that is later, but at most `LONGEST_DEFERRAL`
    /// after its own deadline. A vehicle that asks at most once in this time keeps its deadlines. A last ordering deadline
    /// beyond this maximum belongs to a request with a longer budget and is ignored.
    pub(crate) fn ordering_deadline(self, deadline: Instant) -> Instant {
        let latest = deadline + LONGEST_DEFERRAL;
        let last = self.deadline.filter(|last| *last <= latest);
        let next = last.map_or(deadline, |last| last + SPACING);
        next.clamp(deadline, latest)
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
    fn a_vehicle_that_keeps_its_period_keeps_its_deadlines() {
        let start = Instant::now();
        let mut served = Served::default();
        for period in 0..100 {
            let deadline = start + SPACING * period;
            let ordered = served.turn("a").ordering_deadline(deadline);
            assert_eq!(ordered, deadline);
            served.note("a".to_owned(), ordered);
        }
    }

    #[test]
    fn a_flood_is_deferred_and_a_vehicle_that_lowers_its_budget_is_not() {
        let (start, mut served) = (Instant::now(), Served::default());
        let budget = Duration::from_millis(16);
        served.note("a".to_owned(), start + Duration::from_secs(2));
        let lowered = start + 2 * budget;
        assert_eq!(served.turn("a").ordering_deadline(lowered), lowered);
        // Requests that come every millisecond are ordered 4 ms apart, until they are deferred by the longest time.
        for request in 1..=200 {
            let deadline = start + Duration::from_millis(request) + budget;
            let ordered = served.turn("flood").ordering_deadline(deadline);
            let deferral = Duration::from_millis(3 * (request - 1)).min(LONGEST_DEFERRAL);
            assert_eq!(ordered, deadline + deferral);
            served.note("flood".to_owned(), ordered);
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
