//! The one file that names zenoh.

use std::collections::BTreeSet;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use egp_wire::keys::{self, Name};
use egp_wire::{Timing, WireError};
use prost::Message as _;
use thiserror::Error;
use zenoh::query::Reply;
use zenoh::sample::SampleKind;
use zenoh::{Config, Wait};

use crate::config::VehicleConfig;

/// zenoh refused something.
#[derive(Debug, Error)]
#[error("{doing}: {reason}")]
pub struct NetworkError {
    doing: String,
    reason: String,
}

impl NetworkError {
    fn new(doing: impl Into<String>, reason: &dyn std::fmt::Display) -> Self {
        Self {
            doing: doing.into(),
            reason: reason.to_string(),
        }
    }
}

/// What came back, and when.
#[derive(Debug)]
pub(crate) struct Arrival {
    pub(crate) at: Instant,
    pub(crate) content: Result<Answer, WireError>,
}

/// A reply as sent.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) payload: Vec<u8>,
    pub(crate) timing: Option<Timing>,
}

/// The replicas that are alive, kept up to date by the network.
#[derive(Default)]
struct Live {
    names: Mutex<BTreeSet<Name>>,
    changed: Condvar,
}

impl Live {
    fn lock(&self) -> MutexGuard<'_, BTreeSet<Name>> {
        self.names.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A session and its view of the replicas.
pub(crate) struct Network {
    session: zenoh::Session,
    live: Arc<Live>,
    // Held for its effect: it updates `live`.
    _subscriber: zenoh::pubsub::Subscriber<()>,
}

impl Network {
    pub(crate) fn open(config: &VehicleConfig) -> Result<Self, NetworkError> {
        let session = zenoh::open(configuration(config)?)
            .wait()
            .map_err(|e| NetworkError::new("cannot open the zenoh session", &e))?;
        let live = Arc::new(Live::default());
        let seen = live.clone();
        let subscriber = session
            .liveliness()
            .declare_subscriber(keys::ALL_LIVE)
            .history(true)
            .callback(move |token| {
                let Some(replica) = keys::replica_of_live(token.key_expr().as_str()) else {
                    return;
                };
                match token.kind() {
                    SampleKind::Put => seen.lock().insert(replica),
                    SampleKind::Delete => seen.lock().remove(&replica),
                };
                seen.changed.notify_all();
            })
            .wait()
            .map_err(|e| NetworkError::new("cannot watch the replicas", &e))?;
        Ok(Self {
            session,
            live,
            _subscriber: subscriber,
        })
    }

    /// The replicas that are alive.
    pub(crate) fn replicas(&self) -> Vec<Name> {
        self.live.lock().iter().cloned().collect()
    }

    /// Waits until a replica is alive; false when none came in time.
    pub(crate) fn wait_for_replica(&self, patience: Duration) -> bool {
        let none = |names: &mut BTreeSet<Name>| names.is_empty();
        let waited = self
            .live
            .changed
            .wait_timeout_while(self.live.lock(), patience, none);
        !waited.unwrap_or_else(PoisonError::into_inner).1.timed_out()
    }

    /// Sends a query. The receiver gets what arrives, stamped on arrival, and is closed after the last.
    pub(crate) fn ask(
        &self,
        key: &str,
        payload: Vec<u8>,
        timeout: Duration,
    ) -> Result<Receiver<Arrival>, NetworkError> {
        let (sender, receiver) = channel();
        self.session
            .get(key)
            .payload(payload)
            .encoding("application/protobuf;egp.v1.StepRequest")
            .express(true)
            .timeout(timeout)
            .callback(move |reply| deliver(&sender, reply))
            .wait()
            .map_err(|e| NetworkError::new(format!("cannot ask {key}"), &e))?;
        Ok(receiver)
    }
}

fn deliver(sender: &Sender<Arrival>, reply: Reply) {
    let at = Instant::now();
    let content = match reply.into_result() {
        Ok(sample) => Ok(Answer {
            timing: sample
                .attachment()
                .and_then(|a| Timing::decode(&*a.to_bytes()).ok()),
            payload: sample.payload().to_bytes().into_owned(),
        }),
        // zenoh's own errors, a timeout above all, are not ours to read: silence, like an empty answer.
        Err(error) => match WireError::decode(&error.payload().to_bytes()) {
            Ok(error) => Err(error),
            Err(_) => return,
        },
    };
    // The step that asked may have gone on without the answer.
    let _ = sender.send(Arrival { at, content });
}

fn configuration(config: &VehicleConfig) -> Result<Config, NetworkError> {
    let endpoints = format!("{:?}", config.connect);
    let ours = [
        ("connect/endpoints", endpoints.as_str()),
        // A vehicle is not reached by others.
        ("listen/endpoints", "[]"),
        ("scouting/multicast/enabled", "false"),
        ("transport/link/tx/lease", "2000"),
        (
            "connect/retry",
            "{ period_init_ms: 50, period_max_ms: 200, period_increase_factor: 2 }",
        ),
        ("transport/link/rx/max_message_size", "1048576"),
        ("transport/shared_memory/enabled", "false"),
    ];
    let theirs = config
        .zenoh
        .iter()
        .map(|(key, value)| (key.as_str(), value.as_str()));
    let mut result = Config::default();
    for (key, value) in ours.into_iter().chain(theirs) {
        result
            .insert_json5(key, value)
            .map_err(|e| NetworkError::new(format!("zenoh setting \"{key}\" = '{value}'"), &e))?;
    }
    Ok(result)
}
