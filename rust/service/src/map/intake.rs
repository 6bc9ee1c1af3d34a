//! From a query to the keeper. Runs on the network's receive thread, so it reads keys and sizes only.

use std::collections::HashMap;
use std::sync::mpsc::{SyncSender, TrySendError};
use std::sync::{Mutex, PoisonError};

use egp_wire::keys::Name;
use egp_wire::road_keys::{self, RoadKey, RoadTarget};
use egp_wire::{Code, ROAD_TILES, WireError};

use super::metrics::Metrics;
use crate::network::Received;
use crate::query::Query as _;

/// Queries of one vehicle that may wait; a vehicle that sends more delays only itself.
const WAITING: usize = 64;
/// Largest payload of a query, bytes.
const PAYLOAD: usize = 4096;

/// A query on its way to the keeper.
pub(crate) struct Job {
    pub query: Received,
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
pub(crate) struct Intake {
    pub metrics: Metrics,
    waiting: Mutex<HashMap<(Name, Name), usize>>,
}

impl Intake {
    pub(crate) fn new() -> Self {
        Self {
            metrics: Metrics::new(),
            waiting: Mutex::new(HashMap::new()),
        }
    }

    /// Answers a query, hands it to the keeper, or answers it with an error.
    pub(crate) fn take(&self, query: Received, keeper: &SyncSender<Job>) {
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
            None => return self.refuse(&query, &no_such_key(query.key())),
        };
        if query.length() > PAYLOAD {
            let detail = format!("expected at most {PAYLOAD} bytes, got {}", query.length());
            return self.refuse(&query, &WireError::permanent(Code::Malformed, detail));
        }
        if !self.admit(&key) {
            let detail = format!("{WAITING} queries of this vehicle are waiting already");
            return self.refuse(
                &query,
                &WireError::retryable(Code::Overloaded, 1_000_000, detail),
            );
        }
        let job = Job {
            query,
            kind,
            key,
            index,
        };
        let (job, error) = match keeper.try_send(job) {
            Ok(()) => return,
            Err(TrySendError::Full(job)) => {
                let detail = "too many queries are waiting already";
                (
                    job,
                    WireError::retryable(Code::Overloaded, 1_000_000, detail),
                )
            }
            Err(TrySendError::Disconnected(job)) => {
                let detail = "this map service is going away";
                (job, WireError::retryable(Code::Draining, 1_000_000, detail))
            }
        };
        self.done(&job.key);
        self.refuse(&job.query, &error);
    }

    /// Takes note that a query of a vehicle no longer waits.
    pub(crate) fn done(&self, key: &RoadKey) {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let own = (key.fleet.clone(), key.vehicle.clone());
        if let Some(count) = waiting.get_mut(&own) {
            *count -= 1;
            if *count == 0 {
                waiting.remove(&own);
            }
        }
    }

    /// Sends an error and counts it.
    pub(crate) fn refuse(&self, query: &Received, error: &WireError) {
        self.metrics.refused(error.code);
        tracing::debug!(key = query.key(), code = error.code.as_str_name(), %error, "refused");
        query.refuse(error);
    }

    fn admit(&self, key: &RoadKey) -> bool {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let count = waiting
            .entry((key.fleet.clone(), key.vehicle.clone()))
            .or_default();
        let admitted = *count < WAITING;
        *count += usize::from(admitted);
        admitted
    }
}

fn no_such_key(key: &str) -> WireError {
    let detail = format!(
        "{key} is no key of a map service: expected egp/v1/map/FLEET/VEHICLE/ROAD/tile/INDEX or tiles/FIRST with INDEX \
         and FIRST below {ROAD_TILES}, or egp/v1/map/health or metrics"
    );
    WireError::permanent(Code::Malformed, detail)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_about_a_key_states_the_limit_of_the_index() {
        let error = no_such_key("egp/v1/map/depot/car/ring/tile/7813");
        assert!(error.detail.contains("below 7813"), "{error}");
    }
}
