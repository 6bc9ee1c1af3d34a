//! Access to the network; no other file of this crate uses zenoh.

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};
use std::{borrow::Cow, collections::BTreeMap, fs::File, net::SocketAddr, path::Path};

use egp_session::{NetworkError, get, set};
use egp_wire::{WireError, keys, keys::Name};
use serde_json::Value;
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::{Config, Wait};

use crate::certificates::{self, SETTINGS};
use crate::query::{Answer, Query};
use crate::zenoh_settings::{DEFAULTS, check_endpoints, free_ports};

/// Time for which a service in zenoh's mode `client` waits for its routers.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// The roles of the programs of this crate, as `egp keys` names their certificates and files.
pub(crate) const SERVICE: &str = "service";
pub(crate) const MAP: &str = "map";

/// A zenoh configuration, and the earliest end of its certificates, s since 1970, if it has some.
pub(crate) type Configured = (Config, Option<i64>);

/// A zenoh configuration: this service's defaults or a JSON5 file, then single values by their key. `role` is [`SERVICE`]
/// or [`MAP`].
///
/// # Errors
/// [`NetworkError`] naming the file or the key that zenoh does not accept, or a certificate that cannot be read, is not
/// valid now, or belongs to another role.
pub(crate) fn configuration(
    file: Option<&Path>,
    values: &BTreeMap<String, String>,
    role: &str,
) -> Result<Configured, NetworkError> {
    let given = values
        .iter()
        .map(|(key, value)| (key.as_str(), value.as_str()));
    let config = egp_session::configuration(file, &DEFAULTS, given)?;
    let end = certificates::earliest_end(&tls(&config, &SETTINGS)?, certificates::now(), role);
    let end = end.map_err(|(named, reason)| {
        let place = file.map_or(String::new(), |path| {
            format!("zenoh file {}, ", path.display())
        });
        NetworkError::new(place + &named, &reason)
    })?;
    Ok((config, end))
}

/// Whether a session has zenoh's mode `client`: it is reached through the router that it connects to.
pub(crate) fn is_client(config: &Config) -> Result<bool, NetworkError> {
    Ok(get(config, "mode")? == "client")
}

/// Opens a session with this configuration and closes it again, to see whether a service could start: listeners take a
/// free port in place of their own, on which a service may be running, and no router or peer is contacted. A client with
/// endpoints to connect to is opened as a peer, because zenoh opens no client that connects to nothing. Errors if zenoh would
/// listen on the address of `http`, too.
///
/// # Errors
/// [`NetworkError`] if zenoh opens no session, or a file that the configuration names cannot be read.
pub(crate) fn rehearse(mut config: Config, http: Option<SocketAddr>) -> Result<(), NetworkError> {
    for (key, value) in tls(&config, &["listen_private_key", "connect_private_key"])? {
        if let Some(path) = value.as_str() {
            File::open(path).map_err(|e| NetworkError::new(format!("{key} {path}"), &e))?;
        }
    }
    let mut listen = get(&config, "listen/endpoints")?;
    let connect = get(&config, "connect/endpoints")?;
    check_endpoints(&listen, &connect, http)
        .map_err(|(doing, why)| NetworkError::new(doing, &why))?;
    let connects = connect != Value::Array(Vec::new());
    free_ports(&mut listen);
    let mode = match get(&config, "mode")? {
        Value::String(mode) if mode == "client" && connects => Value::from("peer"),
        mode => mode,
    };
    for (key, value) in [
        ("mode", mode.to_string().as_str()),
        ("listen/endpoints", listen.to_string().as_str()),
        ("connect/endpoints", "[]"),
        ("scouting/multicast/enabled", "false"),
    ] {
        set(&mut config, key, value)?;
    }
    // A session that is dropped is closed.
    egp_session::open(config).map(drop)
}

/// Settings of TLS, each as its key and value. Zenoh shows those with secrets only if they are asked for by their names.
fn tls(config: &Config, names: &[&str]) -> Result<Vec<(String, Value)>, NetworkError> {
    let keys = names
        .iter()
        .map(|name| format!("transport/link/tls/{name}"));
    keys.map(|key| Ok((key.clone(), get(config, &key)?)))
        .collect()
}

/// The configuration of a session that only asks: it listens nowhere, and waits for its links at most `patience`.
///
/// # Errors
/// [`NetworkError`] if it connects to nothing.
pub(crate) fn asking(mut config: Config, patience: Duration) -> Result<Config, NetworkError> {
    let nothing = get(&config, "connect/endpoints")? == Value::Array(Vec::new());
    if nothing && get(&config, "scouting/multicast/enabled")? == Value::Bool(false) {
        let reason = "no endpoint; name a replica or a router that has the library with --connect";
        return Err(NetworkError::new("cannot ask other replicas", &reason));
    }
    let patience = patience.as_millis().to_string();
    for (key, value) in [
        ("listen/endpoints", "[]"),
        ("connect/timeout_ms", patience.as_str()),
        ("connect/exit_on_failure", "false"),
    ] {
        set(&mut config, key, value)?;
    }
    Ok(config)
}

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
        let stated = get(&config, "connect/timeout_ms")?.as_i64();
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
