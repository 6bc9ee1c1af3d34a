//! What the log says about single requests: one event for each answer, with the request's identity as fields.
//!
//! The events have the target `egp_service::request` and the level debug, so `log = "info,egp_service::request=debug"`
//! shows them. With `log_json` each is a line with `fleet`, `vehicle`, `sequence` and the fields of its kind.

use egp_wire::keys::{self, Target};
use egp_wire::{Status, Timing, WireError, status_name};

/// The target of the events.
const TARGET: &str = "egp_service::request";

/// A request was answered with a reply.
pub(crate) fn answered(key: &str, sequence: u64, status: Status, timing: &Timing) {
    if !tracing::enabled!(target: TARGET, tracing::Level::DEBUG) {
        return;
    }
    let (fleet, vehicle) = sender(key);
    tracing::debug!(
        target: TARGET,
        fleet,
        vehicle,
        sequence,
        status = status_name(status),
        queue_us = timing.queue_us,
        step_us = timing.step_us,
        "answered"
    );
}

/// A query was answered with an error. `sequence` is that of a request whose header was read.
pub(crate) fn refused(key: &str, sequence: Option<u64>, error: &WireError) {
    if !tracing::enabled!(target: TARGET, tracing::Level::DEBUG) {
        return;
    }
    let (fleet, vehicle) = sender(key);
    tracing::debug!(
        target: TARGET,
        key,
        fleet,
        vehicle,
        sequence,
        code = error.code_name(),
        %error,
        "refused"
    );
}

/// Fleet and vehicle of the key of a request; none for another key.
fn sender(key: &str) -> (Option<String>, Option<String>) {
    match keys::parse(key) {
        Some(Target::Step { fleet, vehicle }) => {
            (Some(fleet.to_string()), Some(vehicle.to_string()))
        }
        _ => (None, None),
    }
}
