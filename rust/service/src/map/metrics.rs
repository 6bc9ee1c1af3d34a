//! The metrics of the map service, as OpenMetrics text.

use egp_wire::{Code, code_name};
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use crate::metrics::{Outcomes, count, shown, text};

/// Counters of queries and writings by outcome, and the size of the map.
pub(crate) struct Metrics {
    registry: Registry,
    queries: Outcomes,
    writes: Outcomes,
    pub(crate) contributions: Gauge,
    pub(crate) roads: Gauge,
    pub(crate) unsaved: Gauge,
}

impl Metrics {
    pub(crate) fn new() -> Self {
        let mut registry = Registry::with_prefix("egp_map");
        let all = &mut registry;
        Self {
            queries: shown(all, "queries", "Queries by kind or error code"),
            contributions: shown(all, "contributions", "Contributions kept"),
            roads: shown(all, "roads", "Roads with contributions"),
            writes: shown(all, "writes", "Writings of a road's file by outcome"),
            unsaved: shown(
                all,
                "unsaved_roads",
                "Roads that changed since their files were written",
            ),
            registry,
        }
    }

    /// The registry, in which other modules register their metrics.
    pub(crate) fn registry(&mut self) -> &mut Registry {
        &mut self.registry
    }

    pub(crate) fn refused(&self, code: Code) {
        count(&self.queries, code_name(code));
    }

    /// Counts a query of this kind that was answered.
    pub(crate) fn answered(&self, kind: &'static str) {
        count(&self.queries, kind);
    }

    /// Counts a writing of a road's file.
    pub(crate) fn wrote(&self, written: bool) {
        count(&self.writes, if written { "written" } else { "failed" });
    }

    /// The OpenMetrics text.
    pub(crate) fn text(&self) -> String {
        text(&self.registry)
    }
}
