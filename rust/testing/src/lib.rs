//! Data that the tests, benchmarks and examples of several crates share: libraries of GPs, requests of a control step,
//! a vehicle that plans its speed, random optimal control problems, free ports, outputs that take nothing, and the golden
//! messages. Other crates name this one only as a dev-dependency.
#![allow(
    clippy::unwrap_used,
    clippy::missing_panics_doc,
    reason = "a panic here fails the test that asked for the data"
)]

// `cargo bolero` builds this crate's own, empty test program too, which then needs the symbols of the fuzzer.
#[cfg(test)]
use bolero as _;

pub mod drives;
pub mod libraries;
pub mod messages;
pub mod outputs;
pub mod planning;
pub mod ports;
pub mod requests;
