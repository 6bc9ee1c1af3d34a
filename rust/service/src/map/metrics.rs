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

/// Counters of queries by outcome, and the size of the map.
pub(crate) struct Metrics {
    registry: Registry,
    queries: Family<Outcome, Counter>,
    pub(crate) contributions: Gauge,
    pub(crate) roads: Gauge,
}

impl Metrics {
    pub(crate) fn new() -> Self {
        let mut metrics = Self {
            registry: Registry::with_prefix("egp_map"),
            queries: Family::default(),
            contributions: Gauge::default(),
            roads: Gauge::default(),
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
        metrics
    }

    pub(crate) fn refused(&self, code: Code) {
        self.count(code.as_str_name().trim_start_matches("CODE_"));
    }

    pub(crate) fn count(&self, outcome: &str) {
        let outcome = outcome.to_ascii_lowercase();
        self.queries.get_or_create(&Outcome { outcome }).inc();
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
