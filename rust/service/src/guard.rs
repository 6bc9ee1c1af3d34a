//! Who sends a question: the seals of vehicles are checked against their keys, and no question counts twice.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use egp_wire::keys::Name;
use egp_wire::{Code, KeyFileError, KeyRing, Seal, Tag, VehicleKey, WireError};
use prometheus_client::metrics::counter::Counter;

use crate::query::Query;

/// Runs of a vehicle's client that are remembered; a vehicle that starts more often than this while the service runs is
/// answered, but copies of questions from before could be repeated.
const RUNS: usize = 64;

/// The runs of a vehicle, each with the number of its newest question; the run that asked last is the last.
type Runs = VecDeque<(u64, u64)>;

/// The keys of all vehicles, and the questions that came.
pub(crate) struct Guard {
    keys: KeyRing,
    seen: Mutex<BTreeMap<(Name, Name), Runs>>,
    /// Requests of a vehicle after which one of another client with the same key had come.
    twice: Counter,
}

/// A question whose sender has the vehicle's key.
pub(crate) struct Sealed {
    key: VehicleKey,
    question: Tag,
}

impl Sealed {
    /// The tag of the answer.
    pub(crate) fn tag(&self, answer: &[u8]) -> Vec<u8> {
        self.key.answer(&self.question, answer).to_vec()
    }
}

impl Guard {
    /// A guard with these keys.
    pub(crate) fn new(keys: KeyRing) -> Self {
        Self {
            keys,
            seen: Mutex::new(BTreeMap::new()),
            twice: Counter::default(),
        }
    }

    /// Reads the keys.
    pub(crate) fn load(path: &Path) -> Result<Self, KeyFileError> {
        KeyRing::read(path).map(Self::new)
    }

    /// Counts how often clients with one key took turns.
    pub(crate) fn twice(&self) -> Counter {
        self.twice.clone()
    }

    /// Checks the sender of a request of this vehicle.
    ///
    /// # Errors
    /// [`WireError`] with the code `UNAUTHENTICATED` if the vehicle has no key here, the seal is missing or wrong, or the
    /// request or a newer one of the same run came before.
    pub(crate) fn request(
        &self,
        query: &impl Query,
        fleet: &Name,
        vehicle: &Name,
    ) -> Result<Sealed, WireError> {
        let denied = |detail: String| WireError::permanent(Code::Unauthenticated, detail);
        let key = self
            .keys
            .get(fleet, vehicle)
            .map_err(|missing| denied(missing.to_string()))?;
        let seal = Seal::decode(&query.attachment()).ok_or_else(|| {
            denied("the request has no seal; give the client the key of this vehicle".to_owned())
        })?;
        if !key.is_question(query.key(), &seal, &query.payload()) {
            let reason = "the seal was not made with this vehicle's key for this request";
            return Err(denied(reason.to_owned()));
        }
        let (new, twice) = self.note(fleet, vehicle, &seal);
        if twice {
            tracing::warn!(%fleet, %vehicle, "two clients use the key of this vehicle at the same time");
            self.twice.inc();
        }
        if !new {
            let reason = "this request, or a newer one of the same run, came before";
            return Err(denied(reason.to_owned()));
        }
        Ok(Sealed {
            key: key.clone(),
            question: seal.tag,
        })
    }

    /// The sender of a question that anybody may ask, if it can prove who it is.
    pub(crate) fn question(&self, query: &impl Query) -> Option<Sealed> {
        let seal = Seal::decode(&query.attachment())?;
        let (fleet, vehicle) = &seal.vehicle;
        let key = self.keys.get(fleet, vehicle).ok()?;
        key.is_question(query.key(), &seal, &query.payload())
            .then(|| Sealed {
                key: key.clone(),
                question: seal.tag,
            })
    }

    /// Whether the question is newer than all before it of its run, and whether the vehicle's last question came from a run
    /// that began later: then two clients have the same key.
    fn note(&self, fleet: &Name, vehicle: &Name, seal: &Seal) -> (bool, bool) {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let runs = seen.entry((fleet.clone(), vehicle.clone())).or_default();
        let Some(index) = runs.iter().position(|(run, _)| *run == seal.run) else {
            runs.push_back((seal.run, seal.number));
            if runs.len() > RUNS {
                runs.pop_front();
            }
            return (true, false);
        };
        let (twice, new) = (index + 1 < runs.len(), seal.number > runs[index].1);
        if new {
            runs.remove(index);
            runs.push_back((seal.run, seal.number));
        }
        (new, new && twice)
    }
}
