//! Access to the network; no other file of this crate uses zenoh.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};

use egp_session::{NetworkError, get};
use egp_wire::{WireError, keys, keys::Name};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};

use crate::query::{Answer, Query};

/// The configuration of a session.
pub(crate) type Config = zenoh::Config;

/// Time for which a service in zenoh's mode `client` waits for its routers.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// A query that zenoh delivered.
pub(crate) struct Received(zenoh::query::Query);

impl Query for Received {
    fn key(&self) -> &str {
        self.0.key_expr().as_str()
    }

    fn length(&self) -> usize {
        self.0.payload().map_or(0, ZBytes::len)
    }

    fn payload(&self) -> Cow<'_, [u8]> {
        self.0
            .payload()
            .map_or(Cow::Borrowed(&[]), |payload| payload.to_bytes())
    }

    fn attachment_length(&self) -> usize {
        self.0.attachment().map_or(0, ZBytes::len)
    }

    fn attachment(&self) -> Cow<'_, [u8]> {
        self.0
            .attachment()
            .map_or(Cow::Borrowed(&[]), |bytes| bytes.to_bytes())
    }

    fn answer(
        &self,
        key: &str,
        payload: Vec<u8>,
        encoding: &'static str,
        attachment: Option<Vec<u8>>,
    ) {
        let sent = self
            .0
            .reply(key, payload)
            .encoding(encoding)
            .attachment(attachment)
            .wait();
        if let Err(error) = sent {
            tracing::warn!(key, %error, "reply not sent");
        }
    }

    fn refuse(&self, error: &WireError) {
        let sent = self
            .0
            .reply_err(error.encode())
            .encoding("application/protobuf;egp.v1.Error")
            .wait();
        if let Err(error) = sent {
            tracing::warn!(key = self.key(), %error, "error reply not sent");
        }
    }
}

/// An open session with a replica's declarations.
pub(crate) struct Network {
    session: zenoh::Session,
    queryable: Option<zenoh::query::Queryable<()>>,
    token: Option<zenoh::liveliness::LivelinessToken>,
    /// The endpoints that it listens on, as a list in JSON.
    pub(crate) listen: String,
}

impl Network {
    /// Opens a session as [`egp_session::open_patiently`] does; nothing is declared yet. The `connect/timeout_ms` of the
    /// configuration takes the place of `patience` unless it is 0; -1 means that the patience never ends.
    pub(crate) fn open(
        config: Config,
        patience: Duration,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Self, NetworkError> {
        const PAUSE: Duration = Duration::from_millis(500);
        /// Least time between two warnings: of several routers each may have a reason of its own.
        const WARN: Duration = Duration::from_secs(10);
        let warned = Cell::new(None::<Instant>);
        let told = |reason: &str| {
            if warned.get().is_none_or(|last| last.elapsed() >= WARN) {
                warned.set(Some(Instant::now()));
                tracing::warn!(reason, "no session yet; trying again");
            }
        };
        let listen = config.get_json("listen/endpoints").unwrap_or_default();
        let stated = get(&config, "connect/timeout_ms")?;
        let mode = get(&config, "mode")?;
        let of_mode = stated.get(mode.as_str().unwrap_or("peer")); // one number for each mode
        let stated = of_mode.unwrap_or(&stated).as_i64();
        let patience = match stated.map(u64::try_from) {
            Some(Err(_)) => Duration::MAX,
            None | Some(Ok(0)) => patience,
            Some(Ok(stated)) => Duration::from_millis(stated),
        };
        Ok(Self {
            session: egp_session::open_patiently(config, patience, PAUSE, stopped, &told)?,
            queryable: None,
            token: None,
            listen,
        })
    }

    /// Answers queries on the key expression `key`. `intake` runs on zenoh's receive thread.
    pub(crate) fn declare(
        &mut self,
        key: &str,
        intake: impl Fn(Received) + Send + Sync + 'static,
    ) -> Result<(), NetworkError> {
        let queryable = self
            .session
            .declare_queryable(key)
            .complete(true)
            .callback(move |query| intake(Received(query)))
            .wait()
            .map_err(|e| NetworkError::new(format!("cannot declare {key}"), &e))?;
        self.queryable = Some(queryable);
        Ok(())
    }

    /// Whether routers and peers that are connected know a replica of this name. Their answers are awaited for at most 1 s.
    pub(crate) fn announced(&self, replica: &Name) -> bool {
        let (tokens, patience) = (self.session.liveliness(), Duration::from_secs(1));
        let asked = tokens.get(keys::live(replica)).timeout(patience).wait();
        asked.is_ok_and(|found| found.into_iter().any(|reply| reply.result().is_ok()))
    }

    /// The number of replicas that announce themselves. `None` if that is not known within a second, as where access control does
    /// not allow the question.
    pub(crate) fn live(&self) -> Option<usize> {
        let (tokens, patience) = (self.session.liveliness(), Duration::from_secs(1));
        let asked = tokens.get(keys::ALL_LIVE).timeout(patience).wait().ok()?;
        let found = asked
            .into_iter()
            .filter_map(|reply| reply.into_result().ok());
        let names: BTreeSet<String> = found.map(|sample| sample.key_expr().to_string()).collect();
        (!names.is_empty()).then_some(names.len())
    }

    /// Announces the replica to clients.
    pub(crate) fn announce(&mut self, replica: &Name) -> Result<(), NetworkError> {
        let key = keys::live(replica);
        let token = self
            .session
            .liveliness()
            .declare_token(&key)
            .wait()
            .map_err(|e| NetworkError::new(format!("cannot declare {key}"), &e))?;
        self.token = Some(token);
        Ok(())
    }

    /// Withdraws the announcement: clients choose another replica from now on.
    pub(crate) fn withdraw(&mut self) {
        if let Some(Err(error)) = self.token.take().map(|token| token.undeclare().wait()) {
            tracing::warn!(%error, "liveliness token not withdrawn");
        }
    }

    /// Stops receiving queries; returns when the last intake is done. It must not be called from an intake.
    pub(crate) fn undeclare(&mut self) {
        let undeclared = self
            .queryable
            .take()
            .map(|queryable| queryable.undeclare().wait_callbacks().wait());
        if let Some(Err(error)) = undeclared {
            tracing::warn!(%error, "queryable not undeclared");
        }
    }

    /// Closes the session; queries answered before still reach their clients.
    pub(crate) fn close(&self) {
        if let Err(error) = self.session.close().wait() {
            tracing::warn!(%error, "zenoh session not closed cleanly");
        }
    }

    /// Asks all who answer `key`; the channel ends with the last answer, at the latest after `timeout`. Answers beyond those
    /// that it holds are dropped. The question and its answers have the lowest priority on all links.
    pub(crate) fn ask(
        &self,
        key: &str,
        timeout: Duration,
    ) -> Result<Receiver<Answer>, NetworkError> {
        const HELD: usize = 64;
        let (sender, answers) = mpsc::sync_channel(HELD);
        self.session
            .get(key)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .priority(Priority::Background)
            .timeout(timeout)
            .callback(move |reply| {
                let answer = match reply.result() {
                    Ok(sample) => Some(Answer::reply(
                        sample.key_expr(),
                        &sample.payload().to_bytes(),
                    )),
                    Err(error) => Answer::error(&error.payload().to_bytes()),
                };
                // The receiver may have ended, or have enough answers.
                let _ = answer.map(|answer| sender.try_send(answer));
            })
            .wait()
            .map_err(|e| NetworkError::new(format!("cannot ask {key}"), &e))?;
        Ok(answers)
    }

    /// Looks at the session's links and at who else answers.
    pub(crate) fn surroundings(&self) -> Surroundings {
        Surroundings(self.session.clone())
    }

    /// Publishes on keys that are not known in advance.
    pub(crate) fn putter(&self) -> Putter {
        Putter(self.session.clone())
    }

    /// A publisher of small values that may be dropped, because only the newest one is useful.
    pub(crate) fn publisher(&self, key: &str) -> Result<Publisher, NetworkError> {
        self.session
            .declare_publisher(key.to_owned())
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map(Publisher)
            .map_err(|e| NetworkError::new(format!("cannot declare {key}"), &e))
    }
}

/// The programs that a session reaches.
pub(crate) struct Surroundings(zenoh::Session);

impl Surroundings {
    /// The number of sessions that this one is connected to: routers, peers and clients.
    pub(crate) fn links(&self) -> usize {
        self.0.info().transports().wait().count()
    }

    /// Asks all who answer `key`, this program included, and counts their answers until `timeout`. It does not wait for them.
    pub(crate) fn answers(&self, key: &str, timeout: Duration) -> Arc<AtomicUsize> {
        let answers = Arc::new(AtomicUsize::new(0));
        let counted = answers.clone();
        let asked = self
            .0
            .get(key)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .timeout(timeout)
            .callback(move |reply| {
                counted.fetch_add(usize::from(reply.result().is_ok()), Ordering::Relaxed);
            })
            .wait();
        if let Err(error) = asked {
            tracing::debug!(key, %error, "not asked");
        }
        answers
    }
}

/// Publishes small values on any key; they may be dropped, because receivers ask for the content anyway.
pub(crate) struct Putter(zenoh::Session);

impl Putter {
    pub(crate) fn put(&self, key: &str, payload: Vec<u8>) {
        let put = self
            .0
            .put(key, payload)
            .congestion_control(CongestionControl::Drop);
        if let Err(error) = put.wait() {
            tracing::debug!(key, %error, "not published");
        }
    }
}

/// See [`Network::publisher`].
pub(crate) struct Publisher(zenoh::pubsub::Publisher<'static>);

impl Publisher {
    pub(crate) fn publish(&self, payload: Vec<u8>) {
        if let Err(error) = self.0.put(payload).wait() {
            tracing::debug!(%error, "load not published");
        }
    }
}
