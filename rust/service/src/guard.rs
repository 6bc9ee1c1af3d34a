//! Who sends a question: the seals of vehicles are checked against their keys, and no question counts twice.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::time::{Duration, Instant};

use egp_wire::keys::Name;
use egp_wire::{Code, KeyError, KeyFileError, KeyRing, Seal, Tag, Timing, VehicleKey, WireError};
use prometheus_client::metrics::counter::Counter;
use prost::Message as _;

use crate::query::Query;
use crate::sync::{Mutex, PoisonError, RwLock};

/// Runs of a vehicle's client that are remembered: those of a week in which a client starts every ten seconds, in 3 MB. Only
/// the vehicle's key begins a run. A vehicle that starts more often than this while the service runs is answered, but copies
/// of questions from its first runs could be repeated.
const RUNS: usize = 1 << 16;

/// Least time between two warnings about clients that take turns as one vehicle, and between two about requests whose sender did
/// not prove who it is: both may come with each request.
const WARN: Duration = Duration::from_secs(60);

/// The numbers of the questions that came from a vehicle.
#[derive(Default)]
struct Seen {
    /// The number of the newest question of each run.
    newest: HashMap<u64, u64>,
    /// The runs in the order of their first questions.
    order: VecDeque<u64>,
    /// The run that asked last.
    last: u64,
    warned: Option<Instant>,
}

/// What the number of a question says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Noted {
    /// It is larger than all earlier ones of its run.
    New,
    /// It is new, and another run has asked since this one did, which means that two clients use one key.
    OtherRun,
    /// It is not larger than an earlier one of its run.
    Old,
}

impl Seen {
    /// Takes note of the number of a question. Beyond `most` runs the oldest one is removed.
    fn note(&mut self, run: u64, number: u64, most: usize) -> Noted {
        let Some(newest) = self.newest.get_mut(&run) else {
            self.newest.insert(run, number);
            self.order.push_back(run);
            if self.order.len() > most
                && let Some(first) = self.order.pop_front()
            {
                self.newest.remove(&first);
            }
            self.last = run;
            return Noted::New;
        };
        if number <= *newest {
            return Noted::Old;
        }
        *newest = number;
        let same = std::mem::replace(&mut self.last, run) == run;
        if same { Noted::New } else { Noted::OtherRun }
    }
}

/// The keys of all vehicles, and the questions that came.
pub(crate) struct Guard {
    keys: RwLock<KeyRing>,
    seen: Mutex<BTreeMap<(Name, Name), Seen>>,
    /// Number of requests of a known run that follow a request of another run with the same key.
    twice: Counter,
    /// When the last warning about a request was logged whose sender did not prove who it is.
    denied: Mutex<Option<Instant>>,
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
            keys: RwLock::new(keys),
            seen: Mutex::new(BTreeMap::new()),
            twice: Counter::default(),
            denied: Mutex::new(None),
        }
    }

    /// Reads the keys.
    ///
    /// # Errors
    /// [`KeyFileError`] if the file cannot be read, or has no key or something else.
    pub(crate) fn load(path: &Path) -> Result<Self, KeyFileError> {
        if let Some(warning) = exposed(path) {
            tracing::warn!("{warning}");
        }
        read(path).map(Self::new)
    }

    /// Reads the keys again, and returns their number. What came from a vehicle remains known.
    ///
    /// # Errors
    /// As [`Guard::load`]; the keys of before hold then.
    pub(crate) fn reload(&self, path: &Path) -> Result<usize, KeyFileError> {
        let keys = read(path)?;
        let vehicles = keys.len();
        *self.keys.write().unwrap_or_else(PoisonError::into_inner) = keys;
        Ok(vehicles)
    }

    /// The key of a vehicle.
    fn key(&self, fleet: &Name, vehicle: &Name) -> Result<VehicleKey, KeyError> {
        let keys = self.keys.read().unwrap_or_else(PoisonError::into_inner);
        keys.get(fleet, vehicle).cloned()
    }

    /// The counter of how often clients with one key took turns.
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
        let denied = |detail: String| {
            if self.tells_denial(Instant::now()) {
                tracing::warn!(%fleet, %vehicle, "refused a request whose sender did not prove who it is (logged at most once a minute): {detail}");
            }
            WireError::permanent(Code::Unauthenticated, detail)
        };
        let key = self
            .key(fleet, vehicle)
            .map_err(|missing| denied(missing.to_string()))?;
        let attachment = query.attachment();
        let seal = Seal::decode(&attachment).ok_or_else(|| {
            let reason = if attachment.is_empty() {
                "the request has no seal; give the client the key of this vehicle"
            } else {
                "the attachment of the request is no seal (docs/wire.md, section 12)"
            };
            denied(reason.to_owned())
        })?;
        if !key.is_question(query.key(), &seal, &query.payload()) {
            let reason = "the seal was not made with this vehicle's key for this request";
            return Err(denied(reason.to_owned()));
        }
        let noted = self.note(fleet, vehicle, &seal);
        if noted == Noted::OtherRun {
            self.twice.inc();
            if self.warns(fleet, vehicle, Instant::now()) {
                tracing::warn!(%fleet, %vehicle, "two clients use the key of this vehicle at the same time");
            }
        }
        if noted == Noted::Old {
            // This is usual for a vehicle with two routers, by which its requests come twice.
            let reason = "this request, or a newer one of the same run, came before";
            return Err(WireError::permanent(Code::Unauthenticated, reason));
        }
        Ok(Sealed {
            key,
            question: seal.tag,
        })
    }

    /// Whether to log that a request was refused: at most once in [`WARN`].
    fn tells_denial(&self, now: Instant) -> bool {
        let mut last = self.denied.lock().unwrap_or_else(PoisonError::into_inner);
        let due = last.is_none_or(|last| now.saturating_duration_since(last) >= WARN);
        if due {
            *last = Some(now);
        }
        due
    }

    /// The sender of a question that anybody may ask, if it can prove who it is.
    fn question(&self, query: &impl Query) -> Option<Sealed> {
        let seal = Seal::decode(&query.attachment())?;
        let (fleet, vehicle) = &seal.vehicle;
        let key = self.key(fleet, vehicle).ok()?;
        key.is_question(query.key(), &seal, &query.payload())
            .then_some(Sealed {
                key,
                question: seal.tag,
            })
    }

    /// The attachment that proves the answer to a question that anybody may ask; none if the sender cannot prove who it is.
    /// A question with a payload gets no proof: the check would read up to 8 MiB on the network's receive thread.
    pub(crate) fn proof(&self, query: &impl Query, answer: &[u8]) -> Option<Vec<u8>> {
        if query.length() > 0 {
            return None;
        }
        let timing = Timing {
            tag: self.question(query)?.tag(answer),
            ..Timing::default()
        };
        Some(timing.encode_to_vec())
    }

    /// As [`Seen::note`].
    fn note(&self, fleet: &Name, vehicle: &Name, seal: &Seal) -> Noted {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let seen = seen.entry((fleet.clone(), vehicle.clone())).or_default();
        seen.note(seal.run, seal.number, RUNS)
    }

    /// Whether a warning about the vehicle is due, which then counts as given at the time `now`.
    fn warns(&self, fleet: &Name, vehicle: &Name, now: Instant) -> bool {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let warned = &mut (seen.entry((fleet.clone(), vehicle.clone())).or_default()).warned;
        let due = warned.is_none_or(|last| now.saturating_duration_since(last) >= WARN);
        if due {
            *warned = Some(now);
        }
        due
    }
}

/// A warning about a file of secret keys that every user of the machine may read or write.
pub(crate) fn exposed(path: &Path) -> Option<String> {
    const OTHERS: u32 = 0o007;
    let mode = std::fs::metadata(path).ok()?.permissions().mode();
    (mode & OTHERS != 0).then(|| {
        format!(
            "{0} holds secret keys, and every user of this machine may use it (mode {1:03o}): `chmod 600 {0}`",
            path.display(),
            mode & 0o777
        )
    })
}

fn read(path: &Path) -> Result<KeyRing, KeyFileError> {
    let keys = KeyRing::read(path)?;
    if keys.is_empty() {
        return Err(KeyFileError::Content {
            path: path.display().to_string(),
            source: KeyError::Empty,
        });
    }
    Ok(keys)
}

#[cfg(test)]
#[path = "../tests/unit/guard.rs"]
mod tests;
