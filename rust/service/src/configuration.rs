//! The configuration of zenoh for the programs of this crate.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use egp_session::{NetworkError, get, set};
use egp_wire::read_regular;
use serde_json::Value;

use crate::ServiceConfig;
use crate::certificates::{self, SETTINGS};
use crate::network::Config;
use crate::zenoh_settings::{DEFAULTS, free_ports, places, same_address, unusable};

/// The roles of the programs of this crate, as `egp keys` names their certificates and files.
pub(crate) const SERVICE: &str = "service";
pub(crate) const MAP: &str = "map";

/// The settings that name a file which zenoh reads and [`certificates`] does not.
const FILES: [&str; 3] = [
    "transport/link/tls/listen_private_key",
    "transport/link/tls/connect_private_key",
    "transport/auth/usrpwd/dictionary_file",
];

/// A zenoh configuration, and the earliest end of its certificates, s since 1970, if it has some.
pub(crate) type Configured = (Config, Option<i64>);

/// A zenoh configuration: this service's defaults or a JSON5 file, then single values by their key. `role` is [`SERVICE`]
/// or [`MAP`], or none for a program that only asks, whose rights zenoh's access control decides.
///
/// # Errors
/// [`NetworkError`] naming the file or the key that zenoh does not accept, an endpoint that this program cannot use, a file
/// that cannot be read, or a certificate that cannot be read, is not valid now, or belongs to another role.
pub(crate) fn configuration(
    file: Option<&Path>,
    values: &BTreeMap<String, String>,
    role: Option<&str>,
) -> Result<Configured, NetworkError> {
    let given = values
        .iter()
        .map(|(key, value)| (key.as_str(), value.as_str()));
    let config = egp_session::configuration(file, &DEFAULTS, given)?;
    for key in ["listen/endpoints", "connect/endpoints"] {
        if let Some(endpoint) = unusable(get(&config, key)?) {
            let expected = "expected tcp/HOST:PORT or tls/HOST:PORT";
            return Err(NetworkError::new(
                format!("{key} has {endpoint}"),
                &expected,
            ));
        }
    }
    // In place of one list there may be one for each mode.
    let listened = get(&config, "listen/endpoints")?;
    let mut listened = if listened.is_array() {
        places(listened)
    } else {
        Vec::new()
    };
    listened.retain(|endpoint| !endpoint.ends_with(":0"));
    listened.sort();
    let mut repeated = listened.iter().zip(listened.iter().skip(1));
    if let Some((twice, _)) = repeated.find(|(one, next)| one == next) {
        let reason = "an endpoint can be opened once only";
        let doing = format!("listen/endpoints has {twice} twice");
        return Err(NetworkError::new(doing, &reason));
    }
    for key in FILES {
        if let Value::String(path) = get(&config, key)? {
            // zenoh would wait for a writer if it were a pipe.
            read_regular(Path::new(&path), 1)
                .map_err(|e| NetworkError::new(format!("{key} {}", shown(&path)), &e))?;
        }
    }
    let end = earliest_end(file, &config, role)?;
    Ok((config, end))
}

/// Whether a service listens on an endpoint of TLS or connects to one; false if zenoh does not accept its settings.
pub fn is_encrypted(config: &ServiceConfig) -> bool {
    let given = config.zenoh.iter();
    let given = given.map(|(key, value)| (key.as_str(), value.as_str()));
    egp_session::configuration(config.zenoh_file.as_deref(), &[], given)
        .is_ok_and(|config| egp_session::is_encrypted(&config))
}

/// A path as errors show it. A key that was written in its place is not shown.
fn shown(path: &str) -> &str {
    /// `-----` in PEM, and the same in Base64.
    const KEYS: [&str; 2] = ["-----", "LS0tLS"];
    if path.len() > 255 || KEYS.iter().any(|start| path.starts_with(start)) {
        return "(a text that is no path; the setting for a key in Base64 ends in _base64)";
    }
    path
}

/// Checks the certificates that a zenoh configuration file names, as a program should before it opens a session with it.
/// `role` is that of the program for which `egp keys` writes certificates: `service`, `map`, `router`, `operator` or `vehicle`.
/// Returns a warning about the certificate that expires first, if it is time to renew it.
///
/// # Errors
/// [`NetworkError`] naming the file, if it or a certificate cannot be read, or a certificate is not valid now or belongs to
/// another role.
pub fn check_certificates(file: &Path, role: &str) -> Result<Option<String>, NetworkError> {
    let config = egp_session::configuration(Some(file), &[], std::iter::empty())?;
    let end = earliest_end(Some(file), &config, Some(role))?;
    Ok(end.and_then(|end| certificates::warning(end, certificates::now())))
}

/// The earliest end of the certificates of a configuration, s since 1970, if it has some. `file` names it in errors.
fn earliest_end(
    file: Option<&Path>,
    config: &Config,
    role: Option<&str>,
) -> Result<Option<i64>, NetworkError> {
    let end = certificates::earliest_end(&tls(config)?, certificates::now(), role);
    end.map_err(|(named, reason)| {
        let place = file.map_or(String::new(), |path| {
            format!("zenoh file {}, ", path.display())
        });
        NetworkError::new(place + &named, &reason)
    })
}

/// The settings of TLS that name certificates, each as its key and value. Zenoh shows those with secrets only if they are asked
/// for by their names.
fn tls(config: &Config) -> Result<Vec<(String, Value)>, NetworkError> {
    let keys = SETTINGS
        .iter()
        .map(|name| format!("transport/link/tls/{name}"));
    keys.map(|key| Ok((key.clone(), get(config, &key)?)))
        .collect()
}

/// Whether a session has zenoh's mode `client`: it is reached through the router that it connects to.
pub(crate) fn is_client(config: &Config) -> Result<bool, NetworkError> {
    Ok(get(config, "mode")? == "client")
}

/// The endpoints that a session connects to, without their options.
pub(crate) fn connects_to(config: &Config) -> Result<Vec<String>, NetworkError> {
    Ok(places(get(config, "connect/endpoints")?))
}

/// Opens a session with this configuration and closes it again, to see whether a service could start: listeners take a
/// free port in place of their own, on which a service may be running, and no router or peer is contacted. A client is opened
/// as a peer, because zenoh opens no client that connects to nothing. Errors if zenoh would listen on the address of `http`,
/// too.
///
/// # Errors
/// [`NetworkError`] if zenoh opens no session.
pub(crate) fn rehearse(mut config: Config, http: Option<SocketAddr>) -> Result<(), NetworkError> {
    egp_session::check_connects(&config)?;
    let mut listen = get(&config, "listen/endpoints")?;
    if let Some(address) = http
        && let Some(endpoint) = same_address(listen.clone(), address)
    {
        let advice = "zenoh listens there, too; choose another address for `http`";
        let doing = format!("http {address} and {endpoint}");
        return Err(NetworkError::new(doing, &advice));
    }
    free_ports(&mut listen);
    let mode = match get(&config, "mode")? {
        Value::String(mode) if mode == "client" => Value::from("peer"),
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
    drop(egp_session::open(config)?); // closes it
    Ok(())
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

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn configured(values: &[(&str, &str)]) -> Result<Configured, NetworkError> {
        let values = values.iter();
        let values = values.map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
        configuration(None, &values.collect(), Some(SERVICE))
    }

    #[test]
    fn an_endpoint_that_cannot_be_used_is_named_with_its_setting() {
        for key in ["listen/endpoints", "connect/endpoints"] {
            let error = configured(&[(key, "[\"tcp/a:1\", \"udp/127.0.0.1:2\"]")]).unwrap_err();
            let message = error.to_string();
            assert_eq!(
                message,
                format!("{key} has udp/127.0.0.1:2: expected tcp/HOST:PORT or tls/HOST:PORT")
            );
        }
    }

    #[test]
    fn a_client_without_an_endpoint_is_told_what_to_state() {
        let (config, _) =
            configured(&[("mode", "\"client\""), ("listen/endpoints", "[]")]).unwrap();
        let message = rehearse(config, None).unwrap_err().to_string();
        assert!(message.contains("state connect/endpoints"), "{message}");
    }

    #[test]
    fn a_pipe_in_place_of_a_file_is_an_error_and_nobody_waits_for_its_writer() {
        let pipe = std::env::temp_dir().join(format!("egp-zenoh-pipe-{}", std::process::id()));
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        let text = format!("\"{}\"", pipe.display());
        for key in FILES
            .into_iter()
            .chain(["transport/link/tls/root_ca_certificate"])
        {
            let message = configured(&[(key, &text)]).unwrap_err().to_string();
            assert!(message.contains("expected a regular file"), "{message}");
            assert!(message.starts_with(key), "{message}");
        }
        let file = configuration(Some(&pipe), &BTreeMap::new(), Some(SERVICE)).unwrap_err();
        let checked = check_certificates(&pipe, "router").unwrap_err();
        for message in [file.to_string(), checked.to_string()] {
            assert!(message.starts_with("zenoh file "), "{message}");
            assert!(message.contains("expected a regular file"), "{message}");
        }
        std::fs::remove_file(&pipe).unwrap();
    }

    #[test]
    fn an_endpoint_that_is_listened_at_twice_is_an_error() {
        let configured = |endpoints: &str| configured(&[("listen/endpoints", endpoints)]);
        let error = configured(r#"["tcp/[::]:1", "tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447"]"#);
        let message = error.unwrap_err().to_string();
        assert!(
            message.contains("has tcp/127.0.0.1:7447 twice"),
            "{message}"
        );
        let one_in_each_mode =
            r#"{ peer: ["tcp/127.0.0.1:7447"], router: ["tcp/127.0.0.1:7447"] }"#;
        assert!(configured(one_in_each_mode).is_ok());
        assert!(configured(r#"["tcp/127.0.0.1:0", "tcp/127.0.0.1:0"]"#).is_ok());
    }

    #[test]
    fn a_private_key_in_place_of_its_path_is_not_shown() {
        for (start, length) in [("LS0tLS1CRUdJTiBQUklWQVRF", 100), ("MIGHAgEAMBMGByqG", 300)] {
            let secret = format!("{start}{}", "x".repeat(length));
            let key = "transport/link/tls/listen_private_key";
            let error = configured(&[(key, &format!("{secret:?}"))]).unwrap_err();
            let message = error.to_string();
            assert!(
                !message.contains(start) && message.contains("_base64"),
                "{message}"
            );
        }
    }
}
