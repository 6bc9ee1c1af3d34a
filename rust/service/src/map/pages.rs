//! What the pages over HTTP show of a map service.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::intake::Intake;
use crate::http::Pages;
use crate::links::Links;
use crate::network::Received;

/// The pages of a map service.
pub(super) struct MapPages {
    pub(super) intake: Arc<Intake<Received>>,
    pub(super) links: Arc<Links>,
    /// Whether vehicles can ask the service.
    pub(super) serving: Arc<AtomicBool>,
}

impl Pages for MapPages {
    fn not_ready(&self) -> Option<&'static str> {
        self.links.not_ready(self.serving.load(Ordering::Relaxed))
    }

    fn metrics(&self) -> String {
        self.intake.metrics.text()
    }
}
