//! Access to the network; no other file of this crate uses zenoh.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel, sync_channel};
use std::time::{Duration, Instant};

use egp_driver::{MapQuery, Query, QueryId, Question};
use egp_session::NetworkError;
use egp_wire::keys::{self, Name};
use zenoh::bytes::ZBytes;
use zenoh::handlers::DefaultHandler;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Reply};
use zenoh::sample::SampleKind;
use zenoh::session::SessionGetBuilder;
use zenoh::{Config, Wait};

use crate::client::FEW;
use crate::config::{Access, VehicleConfig};

/// An event on the network, with the time at which it was received.
pub(crate) struct Event {
    pub(crate) at: Instant,
    pub(crate) kind: EventKind,
}

/// See [`Event`].
pub(crate) enum EventKind {
    Appeared(Name),
    Gone(Name),
    /// The question whether a replica is still there, after its loss was reported, had no answer.
    Unknown(Name),
    /// A reply's payload and attachment; the latter is empty if there is none.
    Replied(QueryId, Vec<u8>, Vec<u8>),
    /// Payload of an error reply.
    Refused(QueryId, Vec<u8>),
    /// No more answers come.
    Ended(QueryId),
}

/// Opens a session as a vehicle's client does ([`egp_session::open_patiently`]), for programs that send questions of their own.
///
/// # Errors
/// [`NetworkError`] if the configuration is not valid, or zenoh opens no session.
pub fn open_session(config: &VehicleConfig) -> Result<zenoh::Session, NetworkError> {
    open(&config.access())
}

fn open(access: &Access<'_>) -> Result<zenoh::Session, NetworkError> {
    const PAUSE: Duration = Duration::from_millis(100);
    let (zenoh, patience) = (configuration(access)?, access.patience);
    egp_session::open_patiently(zenoh, patience, PAUSE, &mut || false, &|_| ())
}

/// Sends a request as a vehicle's client does, with an attachment unless it is empty. zenoh calls `callback` with each answer
/// that comes within `timeout`, and drops it after the last one.
///
/// # Errors
/// [`NetworkError`] if zenoh does not accept the key, or the session is closed; `callback` is dropped then, too.
pub fn ask(
    session: &zenoh::Session,
    key: &str,
    payload: impl Into<ZBytes>,
    attachment: Vec<u8>,
    timeout: Duration,
    callback: impl Fn(Reply) + Send + Sync + 'static,
) -> Result<(), NetworkError> {
    let request = session
        .get(key)
        .payload(payload)
        .attachment((!attachment.is_empty()).then_some(attachment))
        .encoding("application/protobuf;egp.v1.StepRequest");
    send(request, key, timeout, callback)
}

/// Sends a query whose replies are for `callback`.
fn send(
    query: SessionGetBuilder<'_, '_, DefaultHandler>,
    key: &str,
    timeout: Duration,
    callback: impl Fn(Reply) + Send + Sync + 'static,
) -> Result<(), NetworkError> {
    query
        // zenoh would wait for up to five seconds while a link to a silent replica is full, and later requests would be late.
        .congestion_control(CongestionControl::Drop)
        // By default zenoh keeps a reply until all copies of the question have ended.
        .consolidation(ConsolidationMode::None)
        .timeout(timeout)
        .callback(callback)
        .wait()
        .map_err(|e| NetworkError::new(format!("cannot ask {key}"), &e))
}

/// A session and its events.
pub(crate) struct Network {
    session: zenoh::Session,
    events: Receiver<Event>,
    pub(crate) sender: Sender<Event>,
    status: Option<zenoh::pubsub::Publisher<'static>>,
    // This field is never read; while it lives, it reports replicas that come and go.
    _subscriber: zenoh::pubsub::Subscriber<()>,
}

impl Network {
    pub(crate) fn open(config: &VehicleConfig) -> Result<Self, NetworkError> {
        let session = open_session(config)?;
        let (sender, events) = channel();
        let out = sender.clone();
        let subscriber = session
            .liveliness()
            .declare_subscriber(keys::ALL_LIVE)
            .history(true)
            .callback(move |token| {
                let Some(replica) = keys::replica_of_live(token.key_expr().as_str()) else {
                    return;
                };
                let kind = match token.kind() {
                    SampleKind::Put => EventKind::Appeared(replica),
                    SampleKind::Delete => EventKind::Gone(replica),
                };
                report(&out, kind);
            })
            .wait()
            .map_err(|e| NetworkError::new("cannot watch the replicas", &e))?;
        let status = config
            .publish_status
            .then(|| publisher(&session, config))
            .transpose()?;
        Ok(Self {
            session,
            status,
            events,
            sender,
            _subscriber: subscriber,
        })
    }

    /// The next event, or `None` if there is none within `patience`.
    pub(crate) fn next(&self, patience: Duration) -> Option<Event> {
        // The channel is never closed, because `self` holds a sender.
        let event = self.events.recv_timeout(patience).ok()?;
        if let EventKind::Gone(replica) | EventKind::Unknown(replica) = &event.kind {
            self.look_again(replica);
        }
        Some(event)
    }

    /// Reports a replica, of which a loss was reported, once more if it is there. zenoh reports in a thread for each link:
    /// when a replica changes to another router, its loss by the first one may be reported after its announcement by the
    /// second one, and nothing follows.
    fn look_again(&self, replica: &Name) {
        const PATIENCE: Duration = Duration::from_secs(1);
        let (out, replica) = (self.sender.clone(), replica.clone());
        // An error means that the session is closed, which the next query reports.
        let _ = self
            .session
            .liveliness()
            .get(keys::live(&replica))
            .timeout(PATIENCE)
            .callback(move |reply| {
                let replica = replica.clone();
                // An error is that of the time-out. `next` then asks again.
                report(
                    &out,
                    match reply.result() {
                        Ok(_) => EventKind::Appeared(replica),
                        Err(_) => EventKind::Unknown(replica),
                    },
                );
            })
            .wait();
    }

    /// Publishes how the vehicle drives; the message is dropped if it cannot be sent at once.
    pub(crate) fn publish(&self, status: Vec<u8>) {
        if let Some(publisher) = &self.status {
            // An error means that the session is closed, which the next query reports.
            let _ = publisher.put(status).wait();
        }
    }

    /// Sends a query, whose answers become events. A query that cannot be sent ends immediately.
    pub(crate) fn ask(&self, query: Query) {
        let id = query.id;
        // zenoh drops it after the last answer, together with the callback that holds it.
        let (out, end) = (self.sender.clone(), self.sender.clone());
        let end = AtEnd(move || report(&end, EventKind::Ended(id)));
        let sent = ask(
            &self.session,
            &query.key,
            query.payload,
            query.attachment,
            query.listen,
            move |reply| {
                let _ = &end; // it is dropped with this closure
                report(&out, answer(id, reply));
            },
        );
        if sent.is_err() {
            report(&self.sender, EventKind::Ended(id));
        }
    }

    /// Asks a question and gives payload and attachment of each answer to `read` until that returns something, there are
    /// no more answers, or `patience` is over.
    pub(crate) fn ask_and_wait<T>(
        &self,
        question: &Question,
        patience: Duration,
        mut read: impl FnMut(&[u8], &[u8]) -> Option<T>,
    ) -> Result<Option<T>, NetworkError> {
        let attachment = &question.attachment;
        let replies = self
            .session
            .get(&question.key)
            .attachment((!attachment.is_empty()).then(|| attachment.clone()))
            .consolidation(ConsolidationMode::None)
            .timeout(patience)
            .wait()
            .map_err(|e| NetworkError::new(format!("cannot ask {}", question.key), &e))?;
        while let Ok(reply) = replies.recv() {
            if let Ok(sample) = reply.into_result() {
                let attachment = sample.attachment().map(|bytes| bytes.to_bytes());
                let found = read(
                    &sample.payload().to_bytes(),
                    attachment.as_deref().unwrap_or_default(),
                );
                if found.is_some() {
                    return Ok(found);
                }
            }
        }
        Ok(None)
    }
}

/// An event of the exchange with a map service.
pub(crate) enum MapEvent {
    /// A reply's payload.
    Replied(QueryId, Vec<u8>),
    /// Payload of an error reply.
    Refused(QueryId, Vec<u8>),
    /// No more answers come.
    Ended(QueryId),
}

/// A session with a map service, and its events.
pub(crate) struct MapNetwork {
    session: zenoh::Session,
    events: Receiver<MapEvent>,
    sender: Sender<MapEvent>,
    publications: Receiver<Vec<u8>>,
    /// Whether a publication came while `publications` was full.
    lost: Arc<AtomicBool>,
    // This field is never read; while it lives, it reports the service's publications.
    _subscriber: zenoh::pubsub::Subscriber<()>,
}

impl MapNetwork {
    /// Opens a session that gets the publications on this key.
    pub(crate) fn open(access: &Access<'_>, key: &str) -> Result<Self, NetworkError> {
        let session = open(access)?;
        let (sender, events) = channel();
        let (out, publications) = sync_channel(FEW);
        let lost = Arc::new(AtomicBool::new(false));
        let full = lost.clone();
        let subscriber = session
            .declare_subscriber(key)
            .callback(move |sample| {
                let payload = sample.payload().to_bytes().into_owned();
                if out.try_send(payload).is_err() {
                    full.store(true, Ordering::Relaxed);
                }
            })
            .wait()
            .map_err(|e| NetworkError::new(format!("cannot subscribe to {key}"), &e))?;
        Ok(Self {
            session,
            events,
            sender,
            publications,
            lost,
            _subscriber: subscriber,
        })
    }

    /// The service's publications that tiles have new evidence; the oldest [`FEW`] are kept.
    pub(crate) fn publications(&self) -> impl Iterator<Item = Vec<u8>> {
        self.publications.try_iter().take(FEW)
    }

    /// Whether publications were not kept since the last call.
    pub(crate) fn publications_lost(&self) -> bool {
        self.lost.swap(false, Ordering::Relaxed)
    }

    /// The next event, or `None` if there is none within `patience`.
    pub(crate) fn next(&self, patience: Duration) -> Option<MapEvent> {
        // The channel is never closed, because `self` holds a sender.
        self.events.recv_timeout(patience).ok()
    }

    /// Sends a query, whose answers become events. A query that cannot be sent ends immediately.
    pub(crate) fn ask(&self, query: MapQuery) {
        let id = query.id;
        let (out, end) = (self.sender.clone(), self.sender.clone());
        let end = AtEnd(move || tell(&end, MapEvent::Ended(id)));
        let request = self
            .session
            .get(&query.key)
            .payload(query.payload.unwrap_or_default())
            .encoding("application/protobuf;egp.v1.TileEvidence");
        // An error needs no other treatment than the end of the query.
        let _ = send(request, &query.key, query.listen, move |reply| {
            let _ = &end; // it is dropped with this closure
            let event = match reply.into_result() {
                Ok(sample) => MapEvent::Replied(id, sample.payload().to_bytes().into_owned()),
                Err(error) => MapEvent::Refused(id, error.payload().to_bytes().into_owned()),
            };
            tell(&out, event);
        });
    }
}

fn tell(out: &Sender<MapEvent>, event: MapEvent) {
    // An error means that the client was dropped.
    let _ = out.send(event);
}

/// A publisher of the vehicle's status.
fn publisher(
    session: &zenoh::Session,
    config: &VehicleConfig,
) -> Result<zenoh::pubsub::Publisher<'static>, NetworkError> {
    let key = keys::vehicle(&config.driver.fleet, &config.driver.vehicle);
    session
        .declare_publisher(key.clone())
        .encoding("application/protobuf;egp.v1.VehicleStatus")
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::DataLow)
        .wait()
        .map_err(|e| NetworkError::new(format!("cannot declare {key}"), &e))
}

/// Calls a function when it is dropped.
struct AtEnd<F: Fn()>(F);

impl<F: Fn()> Drop for AtEnd<F> {
    fn drop(&mut self) {
        (self.0)();
    }
}

pub(crate) fn report(out: &Sender<Event>, kind: EventKind) {
    let at = Instant::now();
    // An error means that the client was dropped.
    let _ = out.send(Event { at, kind });
}

fn answer(id: QueryId, reply: Reply) -> EventKind {
    match reply.into_result() {
        Ok(sample) => {
            let attachment = sample.attachment();
            EventKind::Replied(
                id,
                sample.payload().to_bytes().into_owned(),
                attachment.map_or_else(Vec::new, |bytes| bytes.to_bytes().into_owned()),
            )
        }
        Err(error) => EventKind::Refused(id, error.payload().to_bytes().into_owned()),
    }
}

/// A vehicle's settings beside those of every session, each as its key and JSON5 value.
const DEFAULTS: [(&str, &str); 2] = [
    // Other participants do not connect to a vehicle.
    ("listen/endpoints", "[]"),
    ("transport/link/rx/max_message_size", "1048576"),
];

fn configuration(access: &Access<'_>) -> Result<Config, NetworkError> {
    let endpoints = format!("{:?}", access.connect);
    let connect = (!access.connect.is_empty()).then_some(("connect/endpoints", endpoints.as_str()));
    let given = access
        .zenoh
        .iter()
        .map(|(key, value)| (key.as_str(), value.as_str()));
    let values = connect.into_iter().chain(given);
    egp_session::configuration(access.zenoh_file, &DEFAULTS, values)
}

#[cfg(test)]
#[path = "../tests/unit/network.rs"]
mod tests;
