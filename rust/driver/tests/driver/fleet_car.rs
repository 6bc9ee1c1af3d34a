//! A vehicle that takes part in a fleet's map, whose service the test plays.

use std::time::Duration;

use egp_driver::{FleetAction, FleetExchange, FleetNotice, FleetSettings, MapQuery};
use egp_map::{RoadBelief, TILE_CELLS};
use egp_parameters::friction_hypotheses;
use egp_wire::road_keys::RoadKey;
use egp_wire::{Code, RoadTile, RoadTiles, TileOrigin, WireError};

use crate::world::{ms, name};

/// Length of a tile, m.
pub(crate) const TILE: f64 = 2.0 * TILE_CELLS as f64;
pub(crate) const SECOND: Duration = Duration::from_secs(1);
pub(crate) const TIMEOUT: Duration = Duration::from_secs(3);

pub(crate) fn road() -> RoadKey {
    RoadKey {
        fleet: name("depot"),
        vehicle: name("car-7"),
        road: name("ring"),
    }
}

/// A vehicle on a road of this many tiles, and its clock.
pub(crate) struct Car {
    pub(crate) belief: RoadBelief,
    pub(crate) exchange: FleetExchange,
    pub(crate) now: Duration,
    pub(crate) notices: Vec<FleetNotice>,
}

impl Car {
    pub(crate) fn new(tiles: usize) -> Self {
        let mut belief = RoadBelief::new(TILE * tiles as f64, false).unwrap();
        let settings = FleetSettings::default();
        let exchange = FleetExchange::new(road(), settings, ms(0), &mut belief).unwrap();
        Self {
            belief,
            exchange,
            now: ms(0),
            notices: Vec::new(),
        }
    }

    /// The queries since the last call.
    pub(crate) fn queries(&mut self) -> Vec<MapQuery> {
        let mut queries = Vec::new();
        while let Some(action) = self.exchange.next_action() {
            match action {
                FleetAction::Ask(query) => queries.push(query),
                FleetAction::Notice(notice) => self.notices.push(notice),
            }
        }
        queries
    }

    pub(crate) fn query(&mut self) -> MapQuery {
        let [query] = <[MapQuery; 1]>::try_from(self.queries()).unwrap();
        query
    }

    /// Measures a friction of 0.5 from the tile `first` to the tile `last`.
    pub(crate) fn measure(&mut self, first: usize, last: usize) {
        let evidence = friction_hypotheses().map(|h| -0.5 * ((h / 0.5_f64).ln() / 0.1).powi(2));
        let most = evidence.iter().copied().fold(f64::MIN, f64::max);
        let evidence = evidence.map(|value| value - most);
        self.belief.leave();
        let mut s = TILE * first as f64 + 1.0;
        while s < TILE * (last + 1) as f64 {
            self.belief.update(s, Some(&evidence)).unwrap();
            s += 0.2;
        }
    }

    pub(crate) fn period(&mut self) -> Vec<MapQuery> {
        self.exchange.period(self.now, &mut self.belief);
        self.queries()
    }

    pub(crate) fn query_of_a_period(&mut self) -> MapQuery {
        let [query] = <[MapQuery; 1]>::try_from(self.period()).unwrap();
        query
    }

    pub(crate) fn replied(&mut self, query: &MapQuery, payload: &[u8]) {
        (self.exchange).replied(self.now, query.id, payload, &mut self.belief);
        self.ended(query);
    }

    pub(crate) fn refused(&mut self, query: &MapQuery, error: &WireError) {
        self.exchange.refused(query.id, &error.encode());
        self.ended(query);
    }

    pub(crate) fn ended(&mut self, query: &MapQuery) {
        (self.exchange).ended(self.now, query.id, &mut self.belief);
    }

    pub(crate) fn wake(&mut self) {
        self.now = self.exchange.next_wake().unwrap();
        self.exchange.wake(self.now, &mut self.belief);
    }

    pub(crate) fn unsent(&mut self) -> usize {
        self.exchange.unsent(self.now, &mut self.belief)
    }

    /// What the vehicle reckons with in the middle of a tile.
    pub(crate) fn median(&mut self, tile: usize) -> f64 {
        self.belief
            .quantile(TILE * (tile as f64 + 0.5), 0.5)
            .unwrap()
    }
}

/// What others found: friction 0.5 in this tile.
pub(crate) fn found(index: usize) -> RoadTile {
    let mut other = Car::new(index + 1);
    other.measure(index, index);
    RoadTile {
        index: u32::try_from(index).unwrap(),
        rows: other.belief.tile(index).unwrap().bytes().to_vec(),
        origins: vec![TileOrigin {
            vehicle: name("other"),
            age_ms: 500,
        }],
    }
}

pub(crate) fn answer(tiles: &[usize], more: bool) -> Vec<u8> {
    let tiles = tiles.iter().copied().map(found).collect();
    RoadTiles { tiles, more }.encode()
}

/// The keys of queries.
pub(crate) fn keys(queries: &[MapQuery]) -> Vec<String> {
    queries.iter().map(|query| query.key.clone()).collect()
}

pub(crate) fn overloaded() -> WireError {
    WireError::retryable(Code::Overloaded, 0, "busy")
}
