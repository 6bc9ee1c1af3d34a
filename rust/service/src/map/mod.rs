//! The map service: what vehicles measured about the friction of roads, merged and kept.
//!
//! ```text
//! zenoh query ─ intake ─► channel ─► keeper thread ─► reply
//!               key, size   bounded, and   store, merge; also publishes changes
//!                           for each vehicle   and writes the roads' files
//! ```

mod config;
mod file;
mod file_error;
mod folder_lock;
mod intake;
mod keeper;
mod metrics;
mod server;
mod store;

pub use config::MapConfig;
pub use server::{MapError, MapServer, serve_map};
pub use store::{MapLimits, Store, StoreError};
