//! Settings of zenoh as texts: the service's defaults, and the ports of endpoints.

use serde_json::Value;

/// The settings that differ from zenoh's defaults or are documented as limits, each as its key and JSON5 value.
pub(crate) const DEFAULTS: [(&str, &str); 9] = [
    // The service is reachable from this machine only, unless an operator configures more (and access control).
    ("listen/endpoints", r#"["tcp/127.0.0.1:7447"]"#),
    ("scouting/multicast/enabled", "false"),
    // Dead links are detected within two seconds, and lost ones are connected again within about a control period.
    ("transport/link/tx/lease", "2000"),
    (
        "connect/retry",
        "{ period_init_ms: 50, period_max_ms: 200, period_increase_factor: 2 }",
    ),
    // A payload beyond the limit of a request gets an error, and one beyond this limit is dropped without an answer: it
    // must not fill the memory.
    ("transport/link/rx/max_message_size", "8388608"),
    // Further sessions are closed, so that strangers fill a bounded part of the memory.
    ("transport/unicast/max_sessions", "1000"),
    // zenoh waits for 100 connections at once that have not yet become sessions; silent ones must soon make room.
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
    // The first control steps must not wait for a pool of shared memory.
    ("transport/shared_memory/enabled", "false"),
];

/// Replaces the port of each endpoint, `PROTOCOL/HOST:PORT?METADATA#CONFIGURATION`, by 0.
pub(crate) fn free_ports(endpoints: &mut Value) {
    match endpoints {
        Value::String(endpoint) => {
            let end = endpoint.find(['?', '#']).unwrap_or(endpoint.len());
            let (address, rest) = endpoint.split_at(end);
            if let Some((host, port)) = address.rsplit_once(':')
                && port.parse::<u16>().is_ok()
            {
                *endpoint = format!("{host}:0{rest}");
            }
        }
        Value::Array(list) => list.iter_mut().for_each(free_ports),
        Value::Object(modes) => modes.values_mut().for_each(free_ports),
        _ => {}
    }
}
