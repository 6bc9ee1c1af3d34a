//! The metrics of the map service, as OpenMetrics text.

use egp_wire::Code;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Outcome {
    outcome: String,
}

/// Counters of queries and writings by outcome, and the size of the map.
pub(crate) struct Metrics {
    registry: Registry,
    queries: Family<Outcome, Counter>,
    writes: Family<Outcome, Counter>,
    pub(crate) contributions: Gauge,
    pub(crate) roads: Gauge,
    pub(crate) unsaved: Gauge,
}

impl Metrics {
    pub(crate) fn new() -> Self {
        let mut metrics = Self {
            registry: Registry::with_prefix("egp_map"),
            queries: Family::default(),
            writes: Family::default(),
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

    /// Where further metrics are registered.
    pub(crate) fn registry(&mut self) -> &mut Registry {
        &mut self.registry
    }

    pub(crate) fn refused(&self, code: Code) {
        self.count(code.as_str_name().trim_start_matches("CODE_"));
    }

    pub(crate) fn count(&self, outcome: &str) {
        let outcome = outcome.to_ascii_lowercase();
        self.queries.get_or_create(&Outcome { outcome }).inc();
    }

    /// Counts a writing of a road's file.
    pub(crate) fn wrote(&self, written: bool) {
        let outcome = if written { "written" } else { "failed" }.to_owned();
        self.writes.get_or_create(&Outcome { outcome }).inc();
    }

    /// The OpenMetrics text.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        match encode(&mut text, &self.registry) {
            Ok(()) => text,
            Err(error) => format!("# {error}\n# EOF\n"),
        }
    }
}
