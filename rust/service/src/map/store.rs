//! The contributions of all vehicles, in bounded memory. It has no clock: times in s are arguments.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use egp_map::{MergeSettings, Tile, merge};
use egp_wire::keys::Name;
use egp_wire::road_keys::RoadKey;
use egp_wire::{Code, RoadTile, RoadTiles, TILES_AT_ONCE, TileOrigin, WireError};

/// Least time between two looks for evidence that is too old by vehicles that ask for room, s. A look reads the whole store.
const LEAST_BETWEEN_LOOKS: f64 = 1.0;

/// Largest number of tiles that are merged for one question. Those of which nothing is left by their age count, too, because
/// merging them takes time as well.
const MERGED_AT_ONCE: usize = 2 * TILES_AT_ONCE;

/// How much a store keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapLimits {
    /// Contributions in all; each takes about 3.3 kB.
    pub contributions: usize,
    /// Vehicles that contribute to a tile.
    pub vehicles: usize,
    /// Tiles to which a vehicle contributes.
    pub tiles: usize,
    /// Roads to which a vehicle contributes. Each changed road is a file to write.
    pub roads: usize,
}

/// Why a contribution is not kept.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StoreError {
    /// The vehicle contributes to as many tiles as it may.
    #[error(
        "the vehicle contributes to {0} tiles already, which is the limit; older ones are forgotten with time, and the \
         operator of the map can raise `tiles`"
    )]
    Vehicle(usize),
    /// The vehicle contributes to as many roads as it may.
    #[error(
        "the vehicle contributes to {0} roads already, which is the limit; give a road the same name each time; older ones \
         are forgotten with time, and the operator of the map can raise `roads`"
    )]
    Roads(usize),
    /// The store is full.
    #[error(
        "the map has {0} contributions, which is its limit; try again later; its operator can raise `contributions`"
    )]
    Full(usize),
    /// The evidence is too old to be of use.
    #[error("the evidence is {age:.0} s old; after {limit:.0} s it is forgotten")]
    Old {
        /// Age, s.
        age: f64,
        /// Largest age, s.
        limit: f64,
    },
}

impl From<StoreError> for WireError {
    fn from(error: StoreError) -> Self {
        const LATER_US: u32 = 60_000_000;
        match error {
            StoreError::Full(_) => Self::retryable(Code::Overloaded, LATER_US, error.to_string()),
            StoreError::Vehicle(_) | StoreError::Roads(_) => {
                Self::permanent(Code::Overloaded, error.to_string())
            }
            StoreError::Old { .. } => Self::permanent(Code::TooLate, error.to_string()),
        }
    }
}

/// What one vehicle measured in a tile.
#[derive(Clone, Debug)]
pub(crate) struct Contribution {
    pub tile: Tile,
    /// Time of the newest measurement.
    pub at: f64,
}

/// A road of a fleet.
pub(crate) type Road = (Name, Name);
pub(crate) type Tiles = BTreeMap<u32, BTreeMap<Name, Contribution>>;

/// How much a vehicle contributes.
#[derive(Debug, Default)]
struct Share {
    tiles: usize,
    /// The number of tiles of each road that has some.
    roads: HashMap<Name, usize>,
}

/// The newest contribution of each vehicle to each tile.
#[derive(Debug)]
pub struct Store {
    merge: MergeSettings,
    limits: MapLimits,
    roads: BTreeMap<Road, Tiles>,
    /// How much each vehicle of each fleet contributes.
    shares: HashMap<(Name, Name), Share>,
    total: usize,
    /// Time at which expired tiles were last removed.
    looked_at: f64,
    changed: BTreeMap<Road, BTreeSet<u32>>,
    /// The roads that changed since their files were written.
    pub(crate) unsaved: BTreeSet<Road>,
}

impl Store {
    /// An empty store.
    pub fn new(merge: MergeSettings, limits: MapLimits) -> Self {
        Self {
            merge,
            limits,
            roads: BTreeMap::new(),
            shares: HashMap::new(),
            total: 0,
            looked_at: f64::NEG_INFINITY,
            changed: BTreeMap::new(),
            unsaved: BTreeSet::new(),
        }
    }

    /// The limits of what is kept.
    pub(super) fn limits(&self) -> &MapLimits {
        &self.limits
    }

    /// Keeps what a vehicle measured at the time `at` at the latest, in place of its earlier contribution to the tile.
    ///
    /// A contribution older than the kept one of the same vehicle changes nothing, and neither does one without evidence. Of
    /// more vehicles than a tile may have, the oldest contribution is not kept, whether it comes last or was there before.
    ///
    /// # Errors
    /// [`StoreError`]; the store is then unchanged, but for what it forgot because of its age.
    pub fn add(
        &mut self,
        key: &RoadKey,
        index: u32,
        tile: Tile,
        at: f64,
        now: f64,
    ) -> Result<(), StoreError> {
        let (age, limit) = (now - at, self.merge.longest_age());
        if age > limit {
            return Err(StoreError::Old { age, limit });
        }
        let road = (key.fleet.clone(), key.road.clone());
        let kept = (self.roads.get(&road)).and_then(|tiles| tiles.get(&index)?.get(&key.vehicle));
        if tile.is_empty() || kept.is_some_and(|kept| kept.at > at) {
            return Ok(());
        }
        if kept.is_none() {
            if self.is_oldest(&road, index, at) {
                return Ok(());
            }
            self.make_room(key, &road, index, now)?;
            let own = (key.fleet.clone(), key.vehicle.clone());
            let share = self.shares.entry(own).or_default();
            share.tiles += 1;
            *share.roads.entry(key.road.clone()).or_default() += 1;
            self.total += 1;
        }
        self.changed.entry(road.clone()).or_default().insert(index);
        self.unsaved.insert(road.clone());
        let vehicles = self
            .roads
            .entry(road)
            .or_default()
            .entry(index)
            .or_default();
        vehicles.insert(key.vehicle.clone(), Contribution { tile, at });
        Ok(())
    }

    /// Up to [`TILES_AT_ONCE`] tiles from `first` on, of which other vehicles than the asking one measured something. If there
    /// are more, the asking vehicle goes on behind the last tile of the answer. That tile has no evidence and no origins if the
    /// last tiles that were merged have none left.
    pub fn tiles(&self, key: &RoadKey, first: u32, now: f64) -> RoadTiles {
        let road = (key.fleet.clone(), key.road.clone());
        let tiles = self.roads.get(&road).into_iter();
        let mut shared = tiles
            .flat_map(|tiles| tiles.range(first..))
            .filter(|(_, vehicles)| vehicles.keys().any(|vehicle| *vehicle != key.vehicle));
        let (mut found, mut empty) = (Vec::new(), None);
        for (index, vehicles) in shared.by_ref().take(MERGED_AT_ONCE) {
            let tile = self.merged(*index, vehicles, &key.vehicle, now);
            if tile.origins.is_empty() {
                empty = Some(tile);
                continue;
            }
            empty = None;
            found.push(tile);
            if found.len() == TILES_AT_ONCE {
                break;
            }
        }
        let more = shared.next().is_some();
        found.extend(empty.filter(|_| more));
        RoadTiles { tiles: found, more }
    }

    /// What other vehicles than the asking one measured in a tile; without origins if no evidence is left by its age.
    fn merged(
        &self,
        index: u32,
        vehicles: &BTreeMap<Name, Contribution>,
        asking: &Name,
        now: f64,
    ) -> RoadTile {
        let others = vehicles.iter().filter(|(vehicle, _)| *vehicle != asking);
        let aged = others.clone().map(|(_, c)| (&c.tile, now - c.at));
        let merged = merge(aged, &self.merge);
        let origins = others.map(|(vehicle, contribution)| TileOrigin {
            vehicle: vehicle.clone(),
            age_ms: milliseconds(now - contribution.at),
        });
        RoadTile {
            index,
            rows: merged.bytes().to_vec(),
            origins: origins.filter(|_| !merged.is_empty()).collect(),
        }
    }

    /// Forgets what is too old to be of use; the tiles have then changed.
    pub fn expire(&mut self, now: f64) {
        self.looked_at = now;
        let oldest = now - self.merge.longest_age();
        let (shares, total) = (&mut self.shares, &mut self.total);
        let (changed, unsaved) = (&mut self.changed, &mut self.unsaved);
        self.roads.retain(|road, tiles| {
            tiles.retain(|index, vehicles| {
                vehicles.retain(|vehicle, contribution| {
                    let keep = contribution.at >= oldest;
                    if !keep {
                        forget(shares, total, road, vehicle);
                        changed.entry(road.clone()).or_default().insert(*index);
                        unsaved.insert(road.clone());
                    }
                    keep
                });
                !vehicles.is_empty()
            });
            !tiles.is_empty()
        });
    }

    /// The roads and tiles that changed since the last call.
    pub(crate) fn take_changed(&mut self) -> BTreeMap<Road, BTreeSet<u32>> {
        std::mem::take(&mut self.changed)
    }

    /// Everything about a road.
    pub(crate) fn road(&self, road: &Road) -> Option<&Tiles> {
        self.roads.get(road)
    }

    /// Number of contributions.
    pub fn contributions(&self) -> usize {
        self.total
    }

    /// Number of roads.
    pub fn roads(&self) -> usize {
        self.roads.len()
    }

    /// Whether a tile has as many vehicles as it may, whose contributions are all newer than `at`.
    fn is_oldest(&self, road: &Road, index: u32, at: f64) -> bool {
        let vehicles = self.roads.get(road).and_then(|tiles| tiles.get(&index));
        vehicles.is_some_and(|vehicles| {
            let full = vehicles.len() >= self.limits.vehicles;
            full && vehicles.values().all(|kept| kept.at > at)
        })
    }

    /// Why a vehicle may not contribute to a further tile of a road.
    fn limited(&self, key: &RoadKey) -> Option<StoreError> {
        let share = self.shares.get(&(key.fleet.clone(), key.vehicle.clone()))?;
        let MapLimits { tiles, roads, .. } = self.limits;
        if share.tiles >= tiles {
            return Some(StoreError::Vehicle(tiles));
        }
        let new = !share.roads.contains_key(&key.road);
        (new && share.roads.len() >= roads).then_some(StoreError::Roads(roads))
    }

    /// Makes room for a further contribution, or errors if there is none.
    fn make_room(
        &mut self,
        key: &RoadKey,
        road: &Road,
        index: u32,
        now: f64,
    ) -> Result<(), StoreError> {
        let full = |store: &Self| store.total >= store.limits.contributions;
        let crowded = full(self) || self.limited(key).is_some();
        if crowded && now - self.looked_at >= LEAST_BETWEEN_LOOKS {
            self.expire(now);
        }
        if let Some(error) = self.limited(key) {
            return Err(error);
        }
        let vehicles = self
            .roads
            .get_mut(road)
            .and_then(|tiles| tiles.get_mut(&index));
        if let Some(vehicles) = vehicles.filter(|vehicles| vehicles.len() >= self.limits.vehicles) {
            let oldest = vehicles
                .iter()
                .min_by(|(_, a), (_, b)| a.at.total_cmp(&b.at));
            if let Some(oldest) = oldest.map(|(vehicle, _)| vehicle.clone()) {
                vehicles.remove(&oldest);
                forget(&mut self.shares, &mut self.total, road, &oldest);
            }
        }
        if full(self) {
            return Err(StoreError::Full(self.limits.contributions));
        }
        Ok(())
    }
}

fn forget(
    shares: &mut HashMap<(Name, Name), Share>,
    total: &mut usize,
    (fleet, road): &Road,
    vehicle: &Name,
) {
    *total -= 1;
    let own = (fleet.clone(), vehicle.clone());
    let Some(share) = shares.get_mut(&own) else {
        return;
    };
    share.tiles -= 1;
    if let Some(tiles) = share.roads.get_mut(road) {
        *tiles -= 1;
        if *tiles == 0 {
            share.roads.remove(road);
        }
    }
    if share.tiles == 0 {
        shares.remove(&own);
    }
}

/// Whole milliseconds, for the wire; too long a time becomes the longest one.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a cast of floats saturates
pub(crate) fn milliseconds(seconds: f64) -> u32 {
    (1e3 * seconds.max(0.0)) as u32
}

#[cfg(test)]
#[path = "../../tests/unit/map_store.rs"]
mod tests;
