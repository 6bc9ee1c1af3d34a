//! Before the first control period: which replica to ask what it serves.

use egp_wire::keys::{self, Name};
use egp_wire::{Invalid, Limits, Ready};
use thiserror::Error;

use crate::replicas::Replicas;

/// Why what a replica says about itself cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("replica {replica} does not describe itself as the wire demands: {source}")]
pub struct DiscoveryError {
    /// The replica.
    pub replica: Name,
    /// What is wrong.
    pub source: Invalid,
}

/// Finds a replica that is ready, asking the live ones one after another in the order of the vehicle's hash.
#[derive(Clone, Debug)]
pub struct Discovery {
    replicas: Replicas,
    /// Replicas asked since the last time around.
    asked: Vec<Name>,
}

impl Discovery {
    /// A discovery for this vehicle; no replica is known yet.
    pub fn new(fleet: Name, vehicle: Name) -> Self {
        Self {
            replicas: Replicas::new(fleet, vehicle),
            asked: Vec::new(),
        }
    }

    /// Notes that a replica announces itself.
    pub fn replica_appeared(&mut self, replica: Name) {
        self.replicas.appeared(replica);
    }

    /// Notes that a replica withdrew its announcement or was lost.
    pub fn replica_gone(&mut self, replica: &Name) {
        self.replicas.gone(replica);
    }

    /// The replicas that announce themselves; a driver made after the discovery starts with them.
    pub fn live(&self) -> impl Iterator<Item = &Name> {
        self.replicas.live().iter()
    }

    /// The next replica to ask and the key of the question; none when no replica is alive or every one was asked, after
    /// which the next call starts over.
    pub fn next_question(&mut self) -> Option<(Name, String)> {
        let order = self.replicas.order();
        let next = order.into_iter().find(|name| !self.asked.contains(name));
        let Some(replica) = next else {
            self.asked.clear();
            return None;
        };
        self.asked.push(replica.clone());
        let key = keys::ready(&replica);
        Some((replica, key))
    }

    /// Reads a replica's answer: what it serves, or none when it is not ready.
    ///
    /// # Errors
    /// [`DiscoveryError`] when the answer is malformed.
    pub fn answered(replica: &Name, answer: &[u8]) -> Result<Option<Ready>, DiscoveryError> {
        let ready = Ready::decode(answer, &Limits::default()).map_err(|source| DiscoveryError {
            replica: replica.clone(),
            source,
        })?;
        Ok(Some(ready).filter(|ready| ready.ready))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_live_replica_is_asked_once_a_round() {
        let name = |text: &str| text.parse::<Name>().unwrap();
        let mut discovery = Discovery::new(name("fleet"), name("car"));
        assert_eq!(discovery.next_question(), None);
        discovery.replica_appeared(name("a"));
        discovery.replica_appeared(name("b"));
        let round = |discovery: &mut Discovery| -> Vec<String> {
            std::iter::from_fn(|| discovery.next_question().map(|(_, key)| key)).collect()
        };
        let mut first = round(&mut discovery);
        assert_eq!(round(&mut discovery), first);
        first.sort();
        assert_eq!(first, ["egp/v1/r/a/ready", "egp/v1/r/b/ready"]);
        discovery.replica_gone(&name("a"));
        assert_eq!(round(&mut discovery), ["egp/v1/r/b/ready"]);
    }

    #[test]
    fn an_answer_that_cannot_be_read_names_the_replica() {
        let error = Discovery::answered(&"a".parse().unwrap(), b"noise").unwrap_err();
        assert!(
            error.to_string().starts_with("replica a does not"),
            "{error}"
        );
    }
}
