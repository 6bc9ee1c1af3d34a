//! From a query to the keeper. Runs on the network's receive thread, so it reads keys and sizes only.

use egp_wire::road_keys::{self, RoadKey, RoadTarget};
use egp_wire::{Code, ROAD_TILES, WireError};

use super::metrics::Metrics;
use super::turns::{Refused, Turns};
use crate::query::{Query, check_attachment, no_such_key};

/// Queries of one vehicle that may wait. Vehicles are answered in turn, so that a query of another vehicle waits for
/// at most one of them.
const EACH: usize = 64;
/// Queries of all vehicles that may wait.
const ALL: usize = 1024;
/// Largest payload of a query, bytes.
const PAYLOAD: usize = 4096;
/// Time after which a vehicle should try again, µs.
const LATER: u32 = 1_000_000;

/// A query on its way to the keeper.
pub(crate) struct Job<Q> {
    pub query: Q,
    pub kind: QueryKind,
    pub key: RoadKey,
    pub index: u32,
}

/// What a vehicle sends or asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum QueryKind {
    /// What it measured in a tile.
    Evidence,
    /// The tiles from an index on.
    Question,
}

/// The state that intake and keeper share.
pub(crate) struct Intake<Q> {
    pub metrics: Metrics,
    pub waiting: Turns<Job<Q>>,
}

impl<Q: Query> Intake<Q> {
    pub(crate) fn new() -> Self {
        Self {
            metrics: Metrics::new(),
            waiting: Turns::new(EACH, ALL),
        }
    }

    /// Answers a query, lets it wait for the keeper, or answers it with an error.
    pub(crate) fn take(&self, query: Q) {
        if let Err(error) = check_attachment(&query) {
            return self.refuse(&query, &error);
        }
        let (kind, key, index) = match road_keys::parse(query.key()) {
            Some(RoadTarget::Health) => {
                return query.answer(road_keys::HEALTH, b"ok".to_vec(), "text/plain", None);
            }
            Some(RoadTarget::Metrics) => {
                let encoding = "application/openmetrics-text;version=1.0.0";
                let text = self.metrics.text().into_bytes();
                return query.answer(road_keys::METRICS, text, encoding, None);
            }
            Some(RoadTarget::Tile(key, index)) => (QueryKind::Evidence, key, index),
            Some(RoadTarget::Tiles(key, index)) => (QueryKind::Question, key, index),
            None => return self.refuse(&query, &no_such_key(query.key(), &of_a_map())),
        };
        if query.length() > PAYLOAD {
            let detail = format!("expected at most {PAYLOAD} bytes, got {}", query.length());
            return self.refuse(&query, &WireError::permanent(Code::Malformed, detail));
        }
        let vehicle = (key.fleet.clone(), key.vehicle.clone());
        let job = Job {
            query,
            kind,
            key,
            index,
        };
        let (job, code, detail) = match self.waiting.push(vehicle, job) {
            Ok(()) => return,
            Err(Refused::Vehicle(job)) => {
                let detail = format!("{EACH} queries of this vehicle are waiting already");
                (job, Code::Overloaded, detail)
            }
            Err(Refused::All(job)) => {
                let detail = format!("{ALL} queries of all vehicles are waiting already");
                (job, Code::Overloaded, detail)
            }
            Err(Refused::Closed(job)) => {
                let detail = "this map service is shutting down";
                (job, Code::Draining, detail.to_owned())
            }
        };
        self.refuse(&job.query, &WireError::retryable(code, LATER, detail));
    }

    /// Sends an error and counts it.
    pub(crate) fn refuse(&self, query: &Q, error: &WireError) {
        self.metrics.refused(error.code);
        tracing::debug!(key = query.key(), code = error.code_name(), %error, "refused");
        query.refuse(error);
    }
}

/// The end of the error about a key that is not served, for [`no_such_key`].
fn of_a_map() -> String {
    format!(
        "no key of a map service: expected egp/v1/map/FLEET/VEHICLE/ROAD/tile/INDEX or tiles/FIRST with INDEX and FIRST below \
         {ROAD_TILES}, or egp/v1/map/health or metrics"
    )
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::query::recorded::Recorded;

    #[test]
    fn the_error_about_a_key_states_the_limit_of_the_index() {
        let error = no_such_key("egp/v1/map/depot/car/ring/tile/7813", &of_a_map());
        assert!(error.detail.contains("below 7813"), "{error}");
    }

    #[test]
    fn a_vehicle_beyond_its_share_and_a_service_that_ends_are_told_to_the_vehicle() {
        let intake = Intake::new();
        let take = |vehicle: &str| {
            let key = format!("egp/v1/map/depot/{vehicle}/ring/tiles/0");
            let query = Recorded::new(&key, Vec::new());
            intake.take(query.clone());
            query.error()
        };
        for _ in 0..EACH {
            assert_eq!(take("flood"), None);
        }
        let full = take("flood").unwrap();
        assert_eq!((full.code, full.retryable), (Code::Overloaded, true));
        assert!(full.detail.contains("64 queries of this vehicle"), "{full}");
        for vehicle in 1..ALL / EACH {
            for _ in 0..EACH {
                assert_eq!(take(&format!("car-{vehicle}")), None);
            }
        }
        let full = take("late").unwrap();
        assert_eq!((full.code, full.retryable), (Code::Overloaded, true));
        assert!(full.detail.contains("1024 queries of all"), "{full}");
        intake.waiting.close();
        assert_eq!(take("later").unwrap().code, Code::Draining);
    }

    #[test]
    fn a_query_with_a_large_attachment_does_not_wait() {
        let intake = Intake::new();
        let mut query = Recorded::new("egp/v1/map/depot/a/ring/tiles/0", Vec::new());
        query.attachment = vec![7; 513];
        intake.take(query.clone());
        assert_eq!(query.code(), Some(Code::Malformed));
    }
}
