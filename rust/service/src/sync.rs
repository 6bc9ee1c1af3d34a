//! What threads of the service share data with. `egp-interleavings` compiles the files that import this one with
//! other implementations, which run threads in a chosen order.

pub(crate) use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, RwLock, atomic, mpsc};
pub(crate) use std::thread;
