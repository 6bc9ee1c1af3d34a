//! Before the first control period: which replica to ask what it serves.

use std::collections::BTreeMap;
use std::fmt;

use egp_gate::WiderError;
use egp_wire::keys::{self, Name};
use egp_wire::{Invalid, Ready, Tag};
use thiserror::Error;

use crate::config::{DriverConfig, DriverError};
use crate::replicas::Replicas;

/// Why a replica cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Unusable {
    /// It has not answered yet.
    #[error("it has not said what it serves")]
    Silent,
    /// Its answer is no description of a replica.
    #[error("its description is not valid: {0}")]
    Malformed(#[from] Invalid),
    /// Its answer does not have the tag of the vehicle's key.
    #[error(
        "its answer does not have the tag of this vehicle's key; check that the service has the same key"
    )]
    Forged,
    /// It drains.
    #[error("it is about to end")]
    Draining,
    /// It answers only requests with the seal of a vehicle's key, and this vehicle has no key.
    #[error("it answers only vehicles with a secret key; give the client the key of this vehicle")]
    WithoutKey,
    /// It plans for a vehicle that can do less than the gate allows, or that has another mass.
    #[error(transparent)]
    Wider(#[from] WiderError),
}

/// No replica can be used: why not, for each one that is alive.
#[derive(Clone, Debug, PartialEq, Error)]
pub struct DiscoveryError(pub BTreeMap<Name, Unusable>);

impl fmt::Display for DiscoveryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return f.write_str("no replica of the service announces itself");
        }
        f.write_str("no replica of the service can be used")?;
        for (index, (replica, reason)) in self.0.iter().enumerate() {
            let separator = if index == 0 { ':' } else { ';' };
            write!(f, "{separator} replica {replica}: {reason}")?;
        }
        Ok(())
    }
}

/// A query of a replica's `ready` key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Question {
    /// The replica.
    pub replica: Name,
    /// Key to ask.
    pub key: String,
    /// Bytes to attach; empty if there are none.
    pub attachment: Vec<u8>,
}

/// Number of the first seal of a discovery. It is larger than any number of the driver, so that no number is used twice.
const FIRST_NUMBER: u64 = 1 << 63;

/// Finds a replica that can be used, asking the live ones one after another in the order of the vehicle's hash.
#[derive(Clone, Debug)]
pub struct Discovery {
    config: DriverConfig,
    replicas: Replicas,
    /// Replicas asked since the last time around.
    asked: Vec<Name>,
    /// What is wrong with each live replica.
    unusable: BTreeMap<Name, Unusable>,
    /// Number of the last question, and its tag if the vehicle has a key.
    number: u64,
    tag: Option<Tag>,
}

impl Discovery {
    /// A discovery for the driver that is to be made with `config`; no replica is known yet.
    ///
    /// # Errors
    /// [`DriverError`] when budget, hedge, limits or gate settings are out of range.
    pub fn new(config: &DriverConfig) -> Result<Self, DriverError> {
        config.validate()?;
        Ok(Self {
            config: config.clone(),
            replicas: Replicas::new(config.fleet.clone(), config.vehicle.clone()),
            asked: Vec::new(),
            unusable: BTreeMap::new(),
            number: FIRST_NUMBER,
            tag: None,
        })
    }

    /// Notes that a replica announces itself. It counts as absent while 256 others are known.
    pub fn replica_appeared(&mut self, replica: Name) {
        if self.replicas.appeared(replica.clone()) {
            self.unusable.entry(replica).or_insert(Unusable::Silent);
        }
    }

    /// Notes that a replica withdrew its announcement or was lost.
    pub fn replica_gone(&mut self, replica: &Name) {
        self.unusable.remove(replica);
        self.replicas.gone(replica);
    }

    /// The replicas that announce themselves; a driver made after the discovery starts with them, and is told the one whose
    /// answer was used by [`crate::Driver::replica_fits`].
    pub fn live(&self) -> impl Iterator<Item = &Name> {
        self.replicas.live().iter()
    }

    /// The next replica to ask; `None` if no replica is alive or all were asked, after which the next call starts over.
    pub fn next_question(&mut self) -> Option<Question> {
        let mut live = self.replicas.live().iter();
        let Some(replica) = live.find(|name| !self.asked.contains(name)).cloned() else {
            self.asked.clear();
            return None;
        };
        self.asked.push(replica.clone());
        let key = keys::ready(&replica);
        self.number += 1;
        let (attachment, tag) = self.config.seal(&key, self.number, &[]);
        self.tag = tag;
        Some(Question {
            replica,
            key,
            attachment,
        })
    }

    /// Reads a replica's answer to the last question: what it serves, or `None` if the replica cannot be used. The reason is
    /// then kept for [`Discovery::error`], and the next answer or the next replica is to be tried.
    pub fn answered(&mut self, replica: &Name, answer: &[u8], attachment: &[u8]) -> Option<Ready> {
        match self.usable(answer, attachment) {
            Ok(ready) => Some(ready),
            Err(reason) => {
                self.unusable.insert(replica.clone(), reason);
                None
            }
        }
    }

    /// Why no replica can be used, for a transport that has waited long enough.
    pub fn error(&self) -> DiscoveryError {
        DiscoveryError(self.unusable.clone())
    }

    fn usable(&self, answer: &[u8], attachment: &[u8]) -> Result<Ready, Unusable> {
        if !self.config.authentic(self.tag.as_ref(), answer, attachment) {
            return Err(Unusable::Forged);
        }
        let ready = Ready::decode(answer)?;
        if !ready.ready {
            return Err(Unusable::Draining);
        }
        if self.config.lacks_key(&ready) {
            return Err(Unusable::WithoutKey);
        }
        if let Some(planned) = &ready.vehicle {
            self.config.limits.check_within(planned)?;
        }
        Ok(ready)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use egp_parameters::VehicleParameters;

    use super::*;
    use crate::config::RunKey;
    use egp_wire::{KeyRing, Seal, Timing};
    use prost::Message as _;

    const CAR: VehicleParameters = VehicleParameters::FORD_ESCORT;

    fn name(text: &str) -> Name {
        text.parse().unwrap()
    }

    fn discovery(replicas: &[&str]) -> Discovery {
        let limits = egp_gate::Limits::of(&CAR);
        let config = DriverConfig::new("fleet", "car", limits).unwrap();
        let mut discovery = Discovery::new(&config).unwrap();
        for replica in replicas {
            discovery.replica_appeared(name(replica));
        }
        discovery
    }

    fn ready() -> Ready {
        Ready {
            ready: true,
            library: [7; 32],
            others: Vec::new(),
            dt: 0.02,
            horizon: 4,
            history: 3,
            members: vec!["dry".to_owned()],
            envelope: [[0.0; 6], [1.0; 6]],
            vehicle: Some(CAR),
            sealed: false,
        }
    }

    #[test]
    fn every_live_replica_is_asked_once_a_round() {
        let mut discovery = discovery(&[]);
        assert_eq!(discovery.next_question(), None);
        discovery.replica_appeared(name("a"));
        discovery.replica_appeared(name("b"));
        let round = |discovery: &mut Discovery| -> Vec<String> {
            std::iter::from_fn(|| discovery.next_question().map(|question| question.key)).collect()
        };
        let mut first = round(&mut discovery);
        assert_eq!(round(&mut discovery), first);
        first.sort();
        assert_eq!(first, ["egp/v1/r/a/ready", "egp/v1/r/b/ready"]);
        discovery.replica_gone(&name("a"));
        assert_eq!(round(&mut discovery), ["egp/v1/r/b/ready"]);
        let live: Vec<_> = discovery.live().cloned().collect();
        assert_eq!(live, [name("b")]);
    }

    #[test]
    fn replicas_without_number_take_bounded_memory() {
        let mut discovery = discovery(&[]);
        for i in 0..300 {
            discovery.replica_appeared(name(&format!("r{i}")));
        }
        assert_eq!(discovery.error().0.len(), discovery.live().count());
        assert_eq!(discovery.live().count(), 256);
    }

    #[test]
    fn an_answer_that_cannot_be_used_is_kept_as_the_reason_and_the_next_one_is_taken() {
        let mut discovery = discovery(&["a", "b", "c", "d", "e", "f"]);
        let ending = Ready {
            ready: false,
            ..ready()
        };
        let weak = VehicleParameters { a_max: 5.0, ..CAR };
        let weak = Ready {
            vehicle: Some(weak),
            ..ready()
        };
        let closed = Ready {
            sealed: true,
            ..ready()
        };
        assert_eq!(discovery.answered(&name("a"), b"noise", b""), None);
        assert_eq!(discovery.answered(&name("b"), &ending.encode(), b""), None);
        assert_eq!(discovery.answered(&name("c"), &weak.encode(), b""), None);
        discovery.replica_gone(&name("d"));
        assert_eq!(discovery.answered(&name("f"), &closed.encode(), b""), None);
        let error = discovery.error();
        assert!(matches!(error.0[&name("a")], Unusable::Malformed(_)));
        assert_eq!(error.0[&name("b")], Unusable::Draining);
        assert!(
            matches!(&error.0[&name("c")], Unusable::Wider(wider) if wider.name == "force_max")
        );
        assert_eq!(error.0[&name("e")], Unusable::Silent);
        assert_eq!(error.0[&name("f")], Unusable::WithoutKey);
        assert_eq!(error.0.len(), 5);
        let sound = discovery.answered(&name("e"), &ready().encode(), b"");
        assert_eq!(sound, Some(ready()));
    }

    #[test]
    fn the_error_names_each_replica_with_its_reason() {
        let mut discovery = discovery(&["a", "b"]);
        let ending = Ready {
            ready: false,
            ..ready()
        };
        discovery.answered(&name("a"), &ending.encode(), b"");
        assert_eq!(
            discovery.error().to_string(),
            "no replica of the service can be used: replica a: it is about to end; replica b: it has not said what it \
             serves"
        );
        discovery.replica_gone(&name("a"));
        discovery.replica_gone(&name("b"));
        assert_eq!(
            discovery.error().to_string(),
            "no replica of the service announces itself"
        );
    }

    #[test]
    fn a_replica_that_announces_itself_again_keeps_its_reason() {
        let mut discovery = discovery(&["a"]);
        discovery.answered(&name("a"), b"noise", b"");
        discovery.replica_appeared(name("a"));
        let error = discovery.error();
        assert!(matches!(error.0[&name("a")], Unusable::Malformed(_)));
    }

    #[test]
    fn with_a_key_only_an_answer_to_this_question_is_used() {
        let ring = KeyRing::parse(&format!("fleet/car {}", "07".repeat(32))).unwrap();
        let key = ring.get(&name("fleet"), &name("car")).unwrap().clone();
        let mut config = DriverConfig::new("fleet", "car", egp_gate::Limits::of(&CAR)).unwrap();
        config.key = Some(RunKey {
            key: key.clone(),
            run: 5,
        });
        let mut discovery = Discovery::new(&config).unwrap();
        discovery.replica_appeared(name("a"));
        let mut ask = || {
            let question = discovery.next_question().unwrap();
            let seal = Seal::decode(&question.attachment).unwrap();
            assert!(key.is_question(&question.key, &seal, &[]));
            discovery.next_question(); // the round ends
            seal.tag
        };
        let (first, second) = (ask(), ask());
        assert_ne!(first, second);
        let answer = Ready {
            sealed: true,
            ..ready()
        }
        .encode();
        let tagged = |tag: &[u8]| {
            let timing = Timing {
                tag: tag.to_vec(),
                ..Timing::default()
            };
            timing.encode_to_vec()
        };
        for old in [vec![], tagged(&[]), tagged(&key.answer(&first, &answer))] {
            assert_eq!(discovery.answered(&name("a"), &answer, &old), None);
            assert_eq!(discovery.error().0[&name("a")], Unusable::Forged);
        }
        let own = tagged(&key.answer(&second, &answer));
        assert!(discovery.answered(&name("a"), &answer, &own).is_some());
    }

    #[test]
    fn settings_that_no_driver_can_have_are_an_error_before_anyone_is_asked() {
        let config = DriverConfig::new("fleet", "car", egp_gate::Limits::of(&CAR)).unwrap();
        let budget = DriverConfig {
            budget: 1.5,
            ..config.clone()
        };
        assert_eq!(
            Discovery::new(&budget).err(),
            Some(DriverError::Budget(1.5))
        );
        let braking = DriverConfig {
            stop_deceleration: 9.0,
            ..config
        };
        assert!(matches!(
            Discovery::new(&braking).err(),
            Some(DriverError::Gate(_))
        ));
    }
}
