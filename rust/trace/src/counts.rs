//! What became of spans.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Numbers of spans by what became of them. Clones count the same spans.
#[derive(Clone, Debug, Default)]
pub struct Counts(pub(crate) Arc<Outcomes>);

#[derive(Debug, Default)]
pub(crate) struct Outcomes {
    pub(crate) written: AtomicU64,
    pub(crate) dropped: AtomicU64,
    pub(crate) failed: AtomicU64,
}

impl Counts {
    /// Spans that are in the file.
    pub fn written(&self) -> u64 {
        self.0.written.load(Ordering::Relaxed)
    }

    /// Spans that were dropped because too many waited.
    pub fn dropped(&self) -> u64 {
        self.0.dropped.load(Ordering::Relaxed)
    }

    /// Spans that could not be written.
    pub fn failed(&self) -> u64 {
        self.0.failed.load(Ordering::Relaxed)
    }
}
