//! What the map service reported, to be aged while it is silent.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use egp_map::{MergeSettings, RoadBelief, Tile, merge};
use egp_wire::TileOrigin;
use egp_wire::keys::Name;

use crate::driver::Time;

/// Time after which a report is aged again.
const AGEING: Duration = Duration::from_secs(60);
/// Above the largest logarithm of a likelihood ratio that a tile can hold, nats.
const UNLIMITED: f64 = 8.0;

/// A tile as the map service answered it.
#[derive(Clone, Debug)]
struct Report {
    tile: Tile,
    origins: Vec<TileOrigin>,
    at: Time,
    aged: Time,
}

/// The newest report about each tile.
#[derive(Clone, Debug)]
pub(super) struct Reports {
    by_tile: BTreeMap<u32, Report>,
    /// The tiles in the order in which they were aged.
    by_ageing: BTreeSet<(Time, u32)>,
    ageing: MergeSettings,
}

impl Reports {
    pub(super) fn new(lifetime: f64) -> Self {
        Self {
            by_tile: BTreeMap::new(),
            by_ageing: BTreeSet::new(),
            ageing: MergeSettings {
                capacity: UNLIMITED,
                lifetime,
            },
        }
    }

    pub(super) fn replace(&mut self, index: u32, tile: Tile, origins: Vec<TileOrigin>, now: Time) {
        let (at, aged) = (now, now);
        let report = Report {
            tile,
            origins,
            at,
            aged,
        };
        if let Some(before) = self.by_tile.insert(index, report) {
            self.by_ageing.remove(&(before.aged, index));
        }
        self.by_ageing.insert((now, index));
    }

    /// Ages the report that was aged longest ago, if that is due. This takes part of a millisecond.
    pub(super) fn age(&mut self, now: Time, belief: &mut RoadBelief) {
        let Some((aged, index)) = self.by_ageing.first().copied() else {
            return;
        };
        if now.saturating_sub(aged) < AGEING {
            return;
        }
        self.by_ageing.pop_first();
        if let Some(report) = self.by_tile.get_mut(&index) {
            report.aged = now;
            self.by_ageing.insert((now, index));
            let age = now.saturating_sub(report.at).as_secs_f64();
            let tile = merge([(&report.tile, age)], &self.ageing);
            // The belief has this tile, because it took the report when it came.
            let _ = belief.report(index as usize, &tile);
        }
    }

    /// The vehicles whose evidence was reported, each with the time since its newest measurement.
    pub(super) fn origins(&self, now: Time) -> BTreeMap<Name, Duration> {
        let mut found = BTreeMap::new();
        for report in self.by_tile.values() {
            for origin in &report.origins {
                let age = Duration::from_millis(origin.age_ms.into());
                let age = age + now.saturating_sub(report.at);
                found
                    .entry(origin.vehicle.clone())
                    .and_modify(|newest: &mut Duration| *newest = age.min(*newest))
                    .or_insert(age);
            }
        }
        found
    }
}
