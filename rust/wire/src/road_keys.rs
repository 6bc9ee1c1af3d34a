//! Key expressions of the map service; `docs/map.md` describes them.
//!
//! As for control steps, a vehicle is identified by its key and not by the payload, so that access control covers it.

use crate::keys::Name;
use crate::road::ROAD_TILES;

const PREFIX: &str = "egp/v1/map/";
const CHANGED: &str = "egp/v1/@map/";

/// The key expression of the service's queryable.
pub const ALL: &str = "egp/v1/map/**";
/// The key on which the service answers its OpenMetrics text.
pub const METRICS: &str = "egp/v1/map/metrics";
/// The key on which the service answers whether it is alive (`text/plain`).
pub const HEALTH: &str = "egp/v1/map/health";

/// A road of a fleet, as one vehicle addresses it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RoadKey {
    /// Fleet of the vehicle; fleets share no evidence.
    pub fleet: Name,
    /// The vehicle.
    pub vehicle: Name,
    /// Name of the road.
    pub road: Name,
}

impl RoadKey {
    /// The key to which the vehicle sends what it measured in a tile ([`crate::TileEvidence`]).
    pub fn tile(&self, index: u32) -> String {
        format!("{}/tile/{index}", self.prefix())
    }

    /// The key on which the vehicle asks for the tiles from `first` on ([`crate::RoadTiles`]).
    pub fn tiles(&self, first: u32) -> String {
        format!("{}/tiles/{first}", self.prefix())
    }

    fn prefix(&self) -> String {
        format!("{PREFIX}{}/{}/{}", self.fleet, self.vehicle, self.road)
    }
}

/// The key on which the service publishes which tiles of a road have new evidence.
pub fn changed(fleet: &Name, road: &Name) -> String {
    format!("{CHANGED}{fleet}/{road}")
}

/// The purpose of a query to the map service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RoadTarget {
    /// What a vehicle measured in the tile with this index.
    Tile(RoadKey, u32),
    /// A question for the tiles from this index on.
    Tiles(RoadKey, u32),
    /// [`HEALTH`].
    Health,
    /// [`METRICS`].
    Metrics,
}

/// Reads the key of a query, or returns `None` for a key that the service does not answer.
pub fn parse(key: &str) -> Option<RoadTarget> {
    match key {
        HEALTH => return Some(RoadTarget::Health),
        METRICS => return Some(RoadTarget::Metrics),
        _ => {}
    }
    let mut chunks = key.strip_prefix(PREFIX)?.split('/');
    let mut next = || chunks.next();
    let road = RoadKey {
        fleet: next()?.parse().ok()?,
        vehicle: next()?.parse().ok()?,
        road: next()?.parse().ok()?,
    };
    let (what, index) = (next()?, next()?);
    if next().is_some() || !index.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let index: u32 = index.parse().ok().filter(|index| *index < ROAD_TILES)?;
    match what {
        "tile" => Some(RoadTarget::Tile(road, index)),
        "tiles" => Some(RoadTarget::Tiles(road, index)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn keys_read_back() {
        let [fleet, vehicle, road] = ["depot", "car-7", "ring"].map(|name| name.parse().unwrap());
        let key = RoadKey {
            fleet,
            vehicle,
            road,
        };
        assert_eq!(key.tile(3), "egp/v1/map/depot/car-7/ring/tile/3");
        assert_eq!(key.tiles(0), "egp/v1/map/depot/car-7/ring/tiles/0");
        assert_eq!(changed(&key.fleet, &key.road), "egp/v1/@map/depot/ring");
        assert_eq!(parse(&key.tile(3)), Some(RoadTarget::Tile(key.clone(), 3)));
        assert_eq!(parse(&key.tiles(7)), Some(RoadTarget::Tiles(key, 7)));
        assert_eq!(parse(METRICS), Some(RoadTarget::Metrics));
        assert_eq!(parse(HEALTH), Some(RoadTarget::Health));
    }

    #[test]
    fn other_keys_are_none() {
        for key in [
            ALL,
            "egp/v1/map/",
            "egp/v1/map/a/b/c/tile",
            "egp/v1/map/a/b/c/tile/7813",
            "egp/v1/map/a/b/c/tile/+1",
            "egp/v1/map/a/b/c/tile/1/2",
            "egp/v1/map/a/b/c/d/1",
            "egp/v1/map/a/*/c/tile/1",
            "egp/v1/r/map/health",
        ] {
            assert_eq!(parse(key), None, "{key}");
        }
    }
}
