//! Settings of zenoh as texts: the service's defaults, and what endpoints say.

use std::net::{IpAddr, SocketAddr};

use serde_json::Value;

/// A service's settings beside those of every session, each as its key and JSON5 value.
pub(crate) const DEFAULTS: [(&str, &str); 5] = [
    // The service is reachable from this machine only, unless an operator configures more (and access control).
    ("listen/endpoints", r#"["tcp/127.0.0.1:7447"]"#),
    // A payload beyond the limit of a request gets an error, and one beyond this limit is dropped without an answer: it
    // must not fill the memory.
    ("transport/link/rx/max_message_size", "8388608"),
    // Further sessions are closed, so that strangers fill a bounded part of the memory.
    ("transport/unicast/max_sessions", "1000"),
    // zenoh keeps 100 connections at once that have not yet become sessions; a silent one is closed after this time, ms.
    ("transport/unicast/accept_timeout", "2000"),
    // A reply has the quality of service of its query. One that a link has no room for must be dropped: zenoh would otherwise
    // let a worker wait for up to five seconds for a vehicle that does not read. An express reply takes two messages.
    (
        "qos/network",
        r#"[{
            messages: ["query"],
            flows: ["ingress"],
            overwrite: { congestion_control: "drop", express: false },
        }]"#,
    ),
];

/// Protocols of the links that this program is built with.
const PROTOCOLS: [&str; 2] = ["tcp", "tls"];

/// All endpoints of a setting, `PROTOCOL/HOST:PORT?METADATA#CONFIGURATION`: one, a list, or lists by zenoh's mode.
fn each(endpoints: &mut Value, act: &mut dyn FnMut(&mut String)) {
    match endpoints {
        Value::String(endpoint) => act(endpoint),
        Value::Array(list) => list.iter_mut().for_each(|one| each(one, act)),
        Value::Object(modes) => modes.values_mut().for_each(|one| each(one, act)),
        _ => {}
    }
}

/// An endpoint as `PROTOCOL/HOST`, its port, and what follows; `None` without a port.
fn parts(endpoint: &str) -> Option<(&str, u16, &str)> {
    let end = endpoint.find(['?', '#']).unwrap_or(endpoint.len());
    let (address, rest) = endpoint.split_at(end);
    let (host, port) = address.rsplit_once(':')?;
    Some((host, port.parse().ok()?, rest))
}

/// Replaces the port of each endpoint by 0.
pub(crate) fn free_ports(endpoints: &mut Value) {
    each(endpoints, &mut |endpoint| {
        if let Some((host, _, rest)) = parts(endpoint) {
            *endpoint = format!("{host}:0{rest}");
        }
    });
}

/// All endpoints of a setting without their options, among which may be secrets.
pub(crate) fn places(mut endpoints: Value) -> Vec<String> {
    let mut found = Vec::new();
    each(&mut endpoints, &mut |endpoint| {
        let place = endpoint.split(['?', '#']).next().unwrap_or_default();
        found.push(place.to_owned());
    });
    found
}

/// The first endpoint whose protocol this program does not speak, or that has no port.
pub(crate) fn unusable(mut endpoints: Value) -> Option<String> {
    let mut found = None;
    each(&mut endpoints, &mut |endpoint| {
        let protocol = endpoint.split_once('/').map(|(protocol, _)| protocol);
        let spoken = protocol.is_some_and(|protocol| PROTOCOLS.contains(&protocol));
        if !spoken || parts(endpoint).is_none() {
            found.get_or_insert_with(|| endpoint.clone());
        }
    });
    found.and_then(|endpoint| places(Value::from(endpoint)).pop())
}

/// The first endpoint with the same port as `address` and with the same IP address, or where one of the two is unspecified
/// (`0.0.0.0` or `::`): only one of both listeners can be opened.
pub(crate) fn same_address(mut endpoints: Value, address: SocketAddr) -> Option<String> {
    let mut found = None;
    each(&mut endpoints, &mut |endpoint| {
        let Some((place, port, _)) = parts(endpoint) else {
            return;
        };
        let host = place.split_once('/').map_or("", |(_, host)| host);
        let ip = host.trim_matches(['[', ']']).parse::<IpAddr>().ok();
        let same =
            |ip: IpAddr| ip == address.ip() || ip.is_unspecified() || address.ip().is_unspecified();
        if port != 0 && port == address.port() && ip.is_some_and(same) {
            found.get_or_insert_with(|| endpoint.clone());
        }
    });
    found
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn ports_become_free_and_nothing_else_changes() {
        let mut endpoints =
            json!({"peer": ["tcp/[::]:7447#iface=lo", "tls/a.b:1?rel=1"], "router": "tcp/c"});
        free_ports(&mut endpoints);
        let expected =
            json!({"peer": ["tcp/[::]:0#iface=lo", "tls/a.b:0?rel=1"], "router": "tcp/c"});
        assert_eq!(endpoints, expected);
    }

    #[test]
    fn a_protocol_that_is_not_built_in_is_found() {
        assert_eq!(unusable(json!(["tcp/a:1", "tls/b:2"])), None);
        let found = unusable(json!({"client": ["tcp/a:1", "udp/b:2"]}));
        assert_eq!(found.as_deref(), Some("udp/b:2"));
        for wrong in ["here", "tcp/host", "tcp/host:99999", "tcp/host:port"] {
            assert_eq!(unusable(json!(wrong)).as_deref(), Some(wrong));
        }
    }

    #[test]
    fn endpoints_are_shown_without_their_options() {
        let endpoints =
            json!({"client": ["tls/a:1#root_ca_certificate_base64=x"], "peer": "tcp/b:2?rel=1"});
        assert_eq!(places(endpoints), ["tls/a:1", "tcp/b:2"]);
        let found = unusable(json!("udp/a:1#secret"));
        assert_eq!(found.as_deref(), Some("udp/a:1"));
    }

    #[test]
    fn an_address_is_compared_with_those_that_are_listened_on() {
        let endpoints = json!(["tcp/127.0.0.1:7447", "tls/[::]:7450#x=1", "tcp/host:7452"]);
        for (address, same) in [
            ("127.0.0.1:7447", true),
            ("0.0.0.0:7447", true),
            ("127.0.0.2:7447", false),
            ("127.0.0.1:7450", true),
            ("127.0.0.1:7451", false),
            ("127.0.0.1:7452", false),
        ] {
            let address = address.parse().ok();
            let found = address.and_then(|address| same_address(endpoints.clone(), address));
            assert_eq!(found.is_some(), same, "{address:?}");
        }
    }
}
