//! The control step from bytes to bytes: a request as encoded by `egp-wire` in, the encoded reply out.
//!
//! An [`Engine`] holds a library and settings. It has no network, no queue and no clock: the service calls it from its
//! workers, and a vehicle may call it in its own process. Both get the same bytes for the same request.

mod cores;
mod engine;
mod error;
mod file;
mod sync;

pub use cores::available_cores;
pub use engine::{Engine, EngineWorkspace, status, unknown_library};
pub use error::EngineError;
pub use file::read_library;
