//! What threads of the engine share data with. `egp-interleavings` compiles the file that imports this one with other
//! implementations, which run threads in a chosen order.

pub(crate) use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
pub(crate) use std::sync::{Arc, atomic};
