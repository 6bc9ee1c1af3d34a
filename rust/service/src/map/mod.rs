//! The map service: what vehicles measured about the friction of roads, merged and kept.
//!
//! ```text
//! zenoh query ─ intake ─► turns ─► keeper thread ─► reply
//!               key, size   bounded,   store, merge; also publishes changes,
//!                           vehicles   and encodes the roads' files ─► writer thread
//!                           in turn
//! ```

mod config;
mod encoding;
mod file;
mod file_error;
mod folder_lock;
mod intake;
mod keeper;
mod metrics;
mod pages;
mod server;
mod store;
mod turns;
mod writer;

pub use config::MapConfig;
pub use server::{MapError, MapServer, check_map, serve_map};
pub use store::{MapLimits, Store, StoreError};
