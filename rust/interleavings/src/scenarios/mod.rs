//! What the threads of each test do. A scenario panics if a result is wrong, and is called once for each interleaving.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::missing_panics_doc,
    reason = "a panic here fails the test"
)]

pub mod cores;
pub mod queue;
pub mod reload;
pub mod service;
