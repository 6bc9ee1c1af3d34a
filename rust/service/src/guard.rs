//! Who sends a question: the seals of vehicles are checked against their keys, and no question counts twice.

use std::collections::{BTreeMap, HashMap, VecDeque};
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

/// Least time between two warnings about one vehicle: clients that take turns do so at each request.
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
        }
    }

    /// Reads the keys.
    ///
    /// # Errors
    /// [`KeyFileError`] if the file cannot be read, or has no key or something else.
    pub(crate) fn load(path: &Path) -> Result<Self, KeyFileError> {
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
        let denied = |detail: String| WireError::permanent(Code::Unauthenticated, detail);
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
            let reason = "this request, or a newer one of the same run, came before";
            return Err(denied(reason.to_owned()));
        }
        Ok(Sealed {
            key,
            question: seal.tag,
        })
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

/// Reads the keys of a file, which must have at least one.
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
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::query::recorded::{Recorded, at, name};

    /// A guard with the keys of the vehicles `a` and `b`, and the key of `a`.
    fn guard() -> (Guard, VehicleKey) {
        let text = format!("fleet/a {}\nfleet/b {}\n", "a1".repeat(32), "b2".repeat(32));
        let ring = KeyRing::parse(&text).unwrap();
        let key = ring.get(&name("fleet"), &name("a")).unwrap().clone();
        (Guard::new(ring), key)
    }

    /// A request of `a` that is sealed with this key.
    fn sealed(key: &VehicleKey, run: u64, number: u64) -> Recorded {
        let mut query = Recorded::request("a", 1, 1_000);
        let seal = Seal {
            vehicle: (name("fleet"), name("a")),
            run,
            number,
            tag: key.question(&query.key, run, number, &query.payload),
        };
        query.attachment = seal.encode();
        query
    }

    /// Checks a request of the vehicle `a`; the reason if it is not accepted.
    fn accept(guard: &Guard, query: &Recorded) -> Result<Sealed, String> {
        guard
            .request(query, &name("fleet"), &name("a"))
            .map_err(|error| {
                assert_eq!(error.code, Code::Unauthenticated);
                error.detail
            })
    }

    #[test]
    fn the_sender_needs_the_key_of_the_vehicle() {
        let (guard, key) = guard();
        let mut query = sealed(&key, 7, 1);
        let tag = accept(&guard, &query).ok().unwrap().tag(b"reply");
        let question = Seal::decode(&query.attachment).unwrap().tag;
        assert!(key.is_answer(&question, b"reply", &tag));
        let unknown = guard.request(&query, &name("fleet"), &name("c"));
        assert_eq!(unknown.err().unwrap().code, Code::Unauthenticated);
        query.attachment.clear();
        assert!(accept(&guard, &query).err().unwrap().contains("no seal"));
        let foreign = guard.key(&name("fleet"), &name("b")).unwrap();
        let forged = accept(&guard, &sealed(&foreign, 7, 2)).err().unwrap();
        assert!(forged.contains("was not made with"), "{forged}");
    }

    #[test]
    fn a_question_that_anybody_may_ask_is_answered_with_a_proof_to_a_vehicle_only() {
        let (guard, key) = guard();
        let query = sealed(&key, 7, 1);
        let question = Seal::decode(&query.attachment).unwrap().tag;
        let tag = guard.question(&query).unwrap().tag(b"answer");
        assert!(key.is_answer(&question, b"answer", &tag));
        let foreign = guard.key(&name("fleet"), &name("b")).unwrap();
        assert!(guard.question(&sealed(&foreign, 7, 1)).is_none());
    }

    #[test]
    fn a_question_with_a_payload_gets_no_proof() {
        let (guard, key) = guard();
        for (payload, proven) in [(vec![], true), (vec![7], false)] {
            let mut query = Recorded::new("egp/v1/r/main/ready", payload);
            let seal = Seal {
                vehicle: (name("fleet"), name("a")),
                run: 7,
                number: 1,
                tag: key.question(&query.key, 7, 1, &query.payload),
            };
            query.attachment = seal.encode();
            let proof = guard.proof(&query, b"answer");
            let timing = proof.map(|bytes| Timing::decode(&*bytes).unwrap());
            let holds = timing.map(|timing| key.is_answer(&seal.tag, b"answer", &timing.tag));
            assert_eq!(holds, proven.then_some(true));
        }
    }

    #[test]
    fn a_request_counts_once_and_the_newest_of_a_run_ends_the_older_ones() {
        let (guard, key) = guard();
        for (number, new) in [
            (5, true),
            (5, false),
            (4, false),
            (6, true),
            (9, true),
            (6, false),
        ] {
            let outcome = accept(&guard, &sealed(&key, 7, number));
            assert_eq!(outcome.is_ok(), new, "number {number}");
            if let Err(reason) = outcome {
                assert!(reason.contains("came before"), "{reason}");
            }
        }
        assert_eq!(guard.twice().get(), 0);
    }

    #[test]
    fn two_clients_with_one_key_are_counted_at_each_turn() {
        let (guard, key) = guard();
        // The second run takes the place of the first, as after a restart of the vehicle.
        for (run, number, twice) in [
            (7, 1, 0),
            (8, 1, 0),
            (8, 2, 0),
            (7, 2, 1),
            (8, 3, 2),
            (8, 4, 2),
        ] {
            assert!(accept(&guard, &sealed(&key, run, number)).is_ok());
            assert_eq!(guard.twice().get(), twice, "run {run}, number {number}");
        }
        // A copy of an old request is no turn.
        assert!(accept(&guard, &sealed(&key, 7, 1)).is_err());
        assert_eq!(guard.twice().get(), 2);
    }

    #[test]
    fn copies_of_many_runs_are_recognised() {
        let (guard, key) = guard();
        for run in 0..1000 {
            assert!(accept(&guard, &sealed(&key, run, 1)).is_ok());
        }
        for run in 0..1000 {
            assert!(accept(&guard, &sealed(&key, run, 1)).is_err());
        }
        assert_eq!(guard.twice().get(), 0);
    }

    #[test]
    fn the_first_of_too_many_runs_is_forgotten() {
        let mut seen = Seen::default();
        for run in 0..4 {
            assert_eq!(seen.note(run, 1, 3), Noted::New);
        }
        assert_eq!((seen.newest.len(), seen.order.len()), (3, 3));
        for run in 1..4 {
            assert_eq!(seen.note(run, 1, 3), Noted::Old);
        }
        assert_eq!(seen.note(0, 1, 3), Noted::New);
    }

    #[test]
    fn the_log_tells_once_a_minute_of_each_vehicle_that_two_clients_have_its_key() {
        let (guard, start) = (guard().0, Instant::now());
        for (vehicle, ms, due) in [
            ("a", 0.0, true),
            ("a", 20.0, false),
            ("b", 20.0, true),
            ("a", 59_999.0, false),
            ("a", 60_000.0, true),
            ("a", 60_020.0, false),
        ] {
            let warns = guard.warns(&name("fleet"), &name(vehicle), at(start, ms));
            assert_eq!(warns, due, "{vehicle} after {ms} ms");
        }
    }

    #[test]
    fn a_file_without_keys_is_an_error_of_the_service() {
        let file = std::env::temp_dir().join(format!("egp-no-keys-{}", std::process::id()));
        std::fs::write(&file, "# fleet/a: nothing yet\n").unwrap();
        let error = Guard::load(&file).err().map(|error| error.to_string());
        std::fs::remove_file(&file).unwrap();
        let error = error.unwrap();
        let named = error.contains("egp-no-keys") && error.contains("no key");
        assert!(named, "{error}");
    }
}
