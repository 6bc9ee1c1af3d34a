//! Vehicles with real services and map services over TCP on the loopback.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

mod failing_service;
mod fleet_map;
mod patience;

const LIBRARY: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../python/egp_service/shipped/demo-library.safetensors"
);
