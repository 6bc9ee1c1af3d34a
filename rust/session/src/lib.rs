//! Sessions of zenoh, as services and vehicles of this project configure and open them.

use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use thiserror::Error;
use zenoh::{Config, Session, Wait as _};

/// An operation of zenoh that failed.
#[derive(Debug, Error)]
#[error("{doing}: {reason}")]
pub struct NetworkError {
    doing: String,
    reason: String,
}

impl NetworkError {
    /// The operation, and the reason that zenoh gives, from which places in zenoh's source text are left out.
    pub fn new(doing: impl Into<String>, reason: &dyn std::fmt::Display) -> Self {
        Self {
            doing: doing.into(),
            reason: without_places(&reason.to_string()),
        }
    }
}

/// The settings of every session that differ from zenoh's defaults, each as its key and JSON5 value.
pub const DEFAULTS: [(&str, &str); 4] = [
    ("scouting/multicast/enabled", "false"),
    // Dead links are detected within two seconds, and lost ones are connected again within about a control period.
    ("transport/link/tx/lease", "2000"),
    (
        "connect/retry",
        "{ period_init_ms: 50, period_max_ms: 200, period_increase_factor: 2 }",
    ),
    // The first control steps must not wait for a pool of shared memory.
    ("transport/shared_memory/enabled", "false"),
];

/// A zenoh configuration: that of a JSON5 file or else [`DEFAULTS`] followed by `more`, and then `values`, each as its key and
/// JSON5 value.
///
/// # Errors
/// [`NetworkError`] naming the file if it is no regular file or too large, or the file or the key that zenoh does not accept.
pub fn configuration<'a>(
    file: Option<&Path>,
    more: &'a [(&'a str, &'a str)],
    values: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<Config, NetworkError> {
    let (mut config, defaults, more) = match file {
        Some(path) => {
            let doing = || format!("zenoh file {}", path.display());
            check_file(path).map_err(|reason| NetworkError::new(doing(), &reason))?;
            let config = Config::from_file(path)
                .map_err(|e| NetworkError::new(doing(), &refused(&e.to_string())))?;
            (config, [].as_slice(), [].as_slice())
        }
        None => (Config::default(), DEFAULTS.as_slice(), more),
    };
    for (key, value) in defaults.iter().chain(more).copied().chain(values) {
        set(&mut config, key, value)?;
    }
    Ok(config)
}

/// Checks that zenoh may read a file: it waits for the writer of a pipe, and reads a device without end.
///
/// # Errors
/// What is at the path in place of a file of at most 16 MiB.
fn check_file(path: &Path) -> Result<(), String> {
    const MOST: u64 = 16 << 20;
    let found = std::fs::metadata(path).map_err(|error| error.to_string())?;
    if !found.is_file() {
        return Err("expected a regular file, got a folder, a pipe or a device".to_owned());
    }
    if found.len() > MOST {
        return Err("expected a configuration of at most 16 MiB, got more".to_owned());
    }
    Ok(())
}

/// Changes one setting; `value` is JSON5.
///
/// # Errors
/// [`NetworkError`] if zenoh does not accept it. Its message holds no value, which may be a secret, but that of an endpoint.
pub fn set(config: &mut Config, key: &str, value: &str) -> Result<(), NetworkError> {
    config.insert_json5(key, value).map_err(|error| {
        let reason = refused(&error.to_string());
        NetworkError::new(format!("zenoh setting \"{key}\""), &reason)
    })
}

/// Why zenoh does not accept a setting or a file, from its error in Rust's debug format. Endpoints are kept; what else it
/// quotes, which may be a secret, is left out.
pub fn refused(error: &str) -> String {
    let expected = error.rfind("expected ").map(|start| &error[start..]);
    match expected.and_then(|text| text.split('"').next()) {
        // The parser's list of what may come next.
        Some(text) if error.contains("-->") => {
            let text = without_places(text.trim_end());
            format!("this is no JSON5, {text}; quote texts, as in '\"client\"'")
        }
        Some(text) => without_places(text),
        None if error.contains("Endpoints must be") => {
            let message = error.split("msg: \"").nth(1).unwrap_or(error);
            without_places(message.split('"').next().unwrap_or(message))
        }
        None if error.contains("unknown key") => "zenoh has no such setting".to_owned(),
        None if error.contains("Json5Err") => "zenoh does not accept this value".to_owned(),
        None => without_places(error.split('"').next().unwrap_or(error)),
    }
}

/// A text without zenoh's ` at /PLACE/FILE.rs:LINE`.
fn without_places(text: &str) -> String {
    let (mut kept, mut rest) = (String::new(), text);
    while let Some(start) = rest.find(" at /") {
        let (before, place) = rest.split_at(start);
        kept.push_str(before);
        let path = place[4..].split_whitespace().next().unwrap_or_default();
        let known = path.find(".rs:").map(|end| &place[4 + end + 4..]);
        rest = known.map_or_else(
            || {
                kept.push_str(&place[..4]);
                &place[4..]
            },
            |after| {
                let after = after.trim_start_matches(|digit: char| digit.is_ascii_digit());
                after.strip_prefix('.').unwrap_or(after)
            },
        );
    }
    kept + rest
}

/// The value of a setting.
///
/// # Errors
/// [`NetworkError`] if zenoh has no such setting.
pub fn get(config: &Config, key: &str) -> Result<Value, NetworkError> {
    let doing = || format!("zenoh setting \"{key}\"");
    let text = config
        .get_json(key)
        .map_err(|e| NetworkError::new(doing(), &e))?;
    serde_json::from_str(&text).map_err(|e| NetworkError::new(doing(), &e))
}

/// Whether a session listens on an endpoint of TLS or connects to one.
pub fn is_encrypted(config: &Config) -> bool {
    let endpoints = ["listen/endpoints", "connect/endpoints"];
    let mut texts = endpoints.iter().filter_map(|key| config.get_json(key).ok());
    texts.any(|text| text.contains("\"tls/"))
}

/// Checks that a session in zenoh's mode `client` has something to connect to.
///
/// # Errors
/// [`NetworkError`] if it has no endpoint and does not look for routers, either.
pub fn check_connects(config: &Config) -> Result<(), NetworkError> {
    if get(config, "mode")? == "client"
        && get(config, "connect/endpoints")? == Value::Array(Vec::new())
        && get(config, "scouting/multicast/enabled")? == Value::Bool(false)
    {
        let reason = "it has none to connect to; state connect/endpoints, or another mode";
        return Err(NetworkError::new(
            "zenoh's mode \"client\" needs a router or a peer",
            &reason,
        ));
    }
    Ok(())
}

/// Opens a session.
///
/// # Errors
/// [`NetworkError`] if zenoh opens none.
pub fn open(config: Config) -> Result<Session, NetworkError> {
    zenoh::open(config)
        .wait()
        .map_err(|e| NetworkError::new(not_opened(&e.to_string()), &e))
}

/// Opens a session as [`open`] does. In zenoh's mode `client`, in which there is no session without a link, each endpoint is
/// tried, and all of them again after `pause` until `patience` is over or `stopped` returns true. A router that accepts a
/// connection and then says nothing costs at most about that time, too. `report` is called with each reason
/// that differs from the one before.
///
/// # Errors
/// [`NetworkError`] with the last reason if no session opens, and at once as of [`check_connects`].
pub fn open_patiently(
    mut config: Config,
    patience: Duration,
    pause: Duration,
    stopped: &mut dyn FnMut() -> bool,
    report: &dyn Fn(&str),
) -> Result<Session, NetworkError> {
    /// The shortest time in which a link may become a session, ms.
    const LEAST_OPEN: u64 = 500;
    const OPEN_TIMEOUT: &str = "transport/unicast/open_timeout";
    let client = get(&config, "mode")? == "client";
    check_connects(&config)?;
    if client {
        let longest = u64::try_from(patience.as_millis()).unwrap_or(u64::MAX);
        if let Some(stated) = get(&config, OPEN_TIMEOUT)?.as_u64() {
            let most = stated.min(longest.max(LEAST_OPEN));
            set(&mut config, OPEN_TIMEOUT, &most.to_string())?;
        }
        // With more time zenoh would try the first endpoint alone until it is over.
        set(&mut config, "connect/timeout_ms", "0")?;
    }
    let (begun, mut last) = (Instant::now(), String::new());
    loop {
        match open(config.clone()) {
            Err(error) if client && begun.elapsed() < patience && !stopped() => {
                let reason = error.to_string();
                if reason != last {
                    report(&reason);
                }
                last = reason;
                thread::sleep(pause);
            }
            opened => return opened,
        }
    }
}

/// The error message for a session that zenoh did not open, chosen by zenoh's reason.
fn not_opened(reason: &str) -> &'static str {
    if reason.contains("Missing TLS") {
        "a tls endpoint needs a certificate and its key: state a zenoh file that `egp keys` wrote; cannot open the zenoh \
         session"
    } else if reason.contains("Unable to connect") {
        "there is no link to an endpoint of connect/endpoints: no program accepts connections there or answers, or, with TLS, a \
         certificate is missing, has expired or is of another authority; cannot open the zenoh session"
    } else {
        "cannot open the zenoh session"
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn an_error_about_a_setting_says_what_is_wrong_and_not_its_value() {
        for (key, value, reason) in [
            ("mode", "client", "quote texts"),
            ("transport/auth/usrpwd/password", "SECRET", "quote texts"),
            (
                "mode",
                "\"SECRET\"",
                "expected one of `router`, `peer`, `client`",
            ),
            (
                "scouting/multicast/enabled",
                "\"SECRET\"",
                "expected a boolean",
            ),
            ("connect/endpoints", "[\"bogus\"]", ": bogus"),
            ("listen/endpoint", "[]", "zenoh has no such setting"),
            ("listen/endpoints", "7", "expected list of endpoints"),
        ] {
            let error = set(&mut Config::default(), key, value).unwrap_err();
            let message = error.to_string();
            assert!(message.starts_with(&format!("zenoh setting \"{key}\": ")));
            assert!(message.contains(reason), "{message}");
            assert!(
                !message.contains("SECRET") && !message.contains(".rs"),
                "{message}"
            );
        }
    }

    #[test]
    fn places_in_the_source_text_are_left_out() {
        for (said, shown) in [
            ("cannot at /a/b.rs:61.] at /c.rs:338.", "cannot]"),
            (
                "files at /etc/keys and at /a.rs:1 here",
                "files at /etc/keys and here",
            ),
            ("no place", "no place"),
        ] {
            assert_eq!(without_places(said), shown);
        }
    }
}
