//! The metrics of the map service, as OpenMetrics text.

use egp_wire::{Code, code_name};
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use crate::metrics::{Outcomes, count, text};

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
        let mut metrics = Self {
            registry: Registry::with_prefix("egp_map"),
            queries: Outcomes::default(),
            writes: Outcomes::default(),
            contributions: Gauge::default(),
            roads: Gauge::default(),
            unsaved: Gauge::default(),
        };
        let registry = &mut metrics.registry;
        registry.register(
            "queries",
            "Queries by kind or error code",
            metrics.queries.clone(),
        );
        registry.register(
            "contributions",
            "Contributions kept",
            metrics.contributions.clone(),
        );
        registry.register("roads", "Roads with contributions", metrics.roads.clone());
        let help = "Writings of a road's file by outcome";
        registry.register("writes", help, metrics.writes.clone());
        let help = "Roads that changed since their files were written";
        registry.register("unsaved_roads", help, metrics.unsaved.clone());
        metrics
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
