//! What the pages over HTTP show of a service.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::http::Pages;
use crate::intake::Shared;
use crate::links::Links;
use crate::query::Query;

/// The pages of a service.
pub(crate) struct ServicePages<Q> {
    pub(crate) shared: Arc<Shared<Q>>,
    pub(crate) links: Arc<Links>,
    /// Whether vehicles can see the service.
    pub(crate) serving: Arc<AtomicBool>,
}

impl<Q: Query + Send + 'static> Pages for ServicePages<Q> {
    fn not_ready(&self) -> Option<&'static str> {
        let draining = self.shared.draining.load(Ordering::Relaxed);
        let serving = self.serving.load(Ordering::Relaxed);
        (draining.then_some("draining")).or_else(|| self.links.not_ready(serving))
    }

    fn metrics(&self) -> String {
        self.shared.metrics.text(self.shared.queue.len())
    }
}
