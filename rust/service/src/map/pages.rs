//! What the pages over HTTP show of a map service.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::intake::Intake;
use crate::http::Pages;
use crate::links::Links;
use crate::query::Query;

/// The pages of a map service.
pub(super) struct MapPages<Q> {
    pub(super) intake: Arc<Intake<Q>>,
    pub(super) links: Arc<Links>,
    /// Whether the service has begun to serve.
    pub(super) serving: Arc<AtomicBool>,
}

impl<Q: Query + Send + 'static> Pages for MapPages<Q> {
    fn not_ready(&self) -> Option<&'static str> {
        // The keeper closes the queries that wait when it ends, also by a panic.
        let closed = self.intake.waiting.is_closed();
        let serving = self.serving.load(Ordering::Relaxed);
        (closed.then_some("closed")).or_else(|| self.links.not_ready(serving))
    }

    fn metrics(&self) -> String {
        self.intake.metrics.text()
    }
}
