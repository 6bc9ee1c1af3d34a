//! Tests of the code that threads share, under many interleavings of the threads.
//!
//! The files of `egp-service` and `egp-engine` below are compiled once more here, with the locks, channels and threads of
//! [shuttle](https://docs.rs/shuttle) in place of the standard library's: `crate::sync` is another module here than there.
//! Shuttle runs one thread at a time and lets a scheduler choose at each operation on a lock, channel or atomic which one
//! continues, so a test tries thousands of interleavings, and the same ones each time. A thread that waits for ever is
//! found as a deadlock. Shuttle's atomics are sequentially consistent; it does not find a memory ordering that is too weak.
//!
//! [`scenarios`] has what the threads do in each test. The unit tests of the files are not compiled here, because the
//! crate's library is built without `cfg(test)`.
#![allow(
    dead_code,
    reason = "the files are compiled for what threads share; the rest of them is used by their own crates"
)]

#[path = "../../service/src/config.rs"]
mod config;
#[path = "../../service/src/config_error.rs"]
mod config_error;
#[path = "../../engine/src/cores.rs"]
mod cores;
#[path = "../../service/src/events.rs"]
mod events;
#[path = "../../service/src/guard.rs"]
mod guard;
#[path = "../../service/src/handler.rs"]
mod handler;
#[path = "../../service/src/intake.rs"]
mod intake;
#[path = "../../service/src/libraries.rs"]
mod libraries;
#[path = "../../service/src/library_table.rs"]
mod library_table;
#[path = "../../service/src/metrics.rs"]
mod metrics;
#[path = "../../service/src/offer.rs"]
mod offer;
#[path = "../../service/src/query.rs"]
mod query;
#[path = "../../service/src/queue.rs"]
mod queue;
#[path = "../../service/src/reloader.rs"]
mod reloader;
#[path = "../../service/src/served.rs"]
mod served;
#[path = "../../service/src/signature.rs"]
mod signature;
#[path = "../../service/src/standing.rs"]
mod standing;
#[path = "../../service/src/traces.rs"]
mod traces;
#[path = "../../service/src/worker.rs"]
mod worker;

mod question;
pub mod scenarios;
mod sync;
