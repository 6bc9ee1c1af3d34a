//! Endpoints in configurations of zenoh.

use serde_json::Value;

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
