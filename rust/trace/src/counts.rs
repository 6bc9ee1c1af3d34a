//! What became of spans.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Numbers of spans by what became of them. Clones count the same spans.
#[derive(Clone, Debug, Default)]
pub struct Counts(pub(crate) Arc<Outcomes>);

#[derive(Debug, Default)]
pub(crate) struct Outcomes {
    pub(crate) written: AtomicU64,
    pub(crate) dropped: AtomicU64,
    pub(crate) failed: AtomicU64,
    /// The error of the last spans that could not be written.
    pub(crate) error: Mutex<Option<String>>,
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
        self.0.failed.load(Ordering::Acquire)
    }

    /// The system's error about the last spans that could not be written; none if all were written.
    pub fn last_error(&self) -> Option<String> {
        let error = self.0.error.lock();
        error.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Takes note of spans that could not be written.
    pub(crate) fn fail(&self, spans: u64, error: String) {
        *self.0.error.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        // The number is changed last, so that a thread that sees the new number also finds the reason.
        self.0.failed.fetch_add(spans, Ordering::Release);
    }
}
