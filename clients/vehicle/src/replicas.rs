//! In which order the replicas are asked.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use egp_wire::keys::Name;

/// How long a replica that let a deadline pass is asked last. About half a lease: by then a frozen one is
/// either back or on its way to being dropped.
const DISTRUST: Duration = Duration::from_secs(1);

/// Rendezvous order, with those that were silent lately at the end.
pub(crate) struct Preference {
    fleet: Name,
    vehicle: Name,
    silent: HashMap<Name, Instant>,
}

impl Preference {
    pub(crate) fn new(fleet: Name, vehicle: Name) -> Self {
        Self {
            fleet,
            vehicle,
            silent: HashMap::new(),
        }
    }

    /// Notes that a replica let a deadline pass.
    pub(crate) fn distrust(&mut self, replica: Name, now: Instant) {
        self.silent.insert(replica, now);
    }

    /// The replicas in the order to ask them.
    pub(crate) fn order(&mut self, live: Vec<Name>, now: Instant) -> Vec<Name> {
        self.silent
            .retain(|_, since| now.duration_since(*since) < DISTRUST);
        let mut order = egp_wire::rank(&self.fleet, &self.vehicle, live);
        order.sort_by_key(|replica| self.silent.contains_key(replica)); // stable
        order
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_silent_replica_is_asked_last_for_a_while() {
        let name = |text: &str| text.parse::<Name>().unwrap();
        let live = || vec![name("a"), name("b"), name("c")];
        let mut preference = Preference::new(name("fleet"), name("car"));
        let start = Instant::now();
        let usual = preference.order(live(), start);
        preference.distrust(usual[0].clone(), start);
        let expected = [usual[1].clone(), usual[2].clone(), usual[0].clone()];
        assert_eq!(preference.order(live(), start), expected);
        assert_eq!(preference.order(live(), start + DISTRUST), usual);
    }
}
