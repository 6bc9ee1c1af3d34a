//! Which tiles of the map count as changed.
#![allow(clippy::unwrap_used)]

use egp_map::TILE_BYTES;

use super::*;

fn store(vehicles: usize) -> Store {
    let limits = MapLimits {
        contributions: 10,
        vehicles,
        tiles: 10,
        roads: 10,
    };
    Store::new(MergeSettings::default(), limits)
}

fn key(vehicle: &str) -> RoadKey {
    RoadKey {
        fleet: "depot".parse().unwrap(),
        vehicle: vehicle.parse().unwrap(),
        road: "ring".parse().unwrap(),
    }
}

/// A tile with this ratio of likelihoods.
fn tile(ratio: u8) -> Tile {
    Tile::from_bytes(&[ratio, 0].repeat(TILE_BYTES / 2)).unwrap()
}

#[test]
fn tiles_whose_evidence_expires_have_changed() {
    let mut store = store(10);
    for (vehicle, index, at) in [("a", 3, 0.0), ("b", 3, 1e4), ("a", 7, 1e4)] {
        store.add(&key(vehicle), index, tile(7), at, at).unwrap();
    }
    store.take_changed();
    let road = (key("a").fleet, key("a").road);
    for (index, kept, now) in [(3, true, 1.2e4), (7, false, 1e6)] {
        store.unsaved.clear();
        store.expire(now);
        assert!(store.unsaved.contains(&road));
        assert!(store.take_changed()[&road].contains(&index));
        assert_eq!(store.road(&road).is_some(), kept);
    }
    store.expire(2e6);
    assert!(store.take_changed().is_empty());
}

#[test]
fn a_tile_without_evidence_takes_no_place_and_changes_nothing() {
    let mut store = store(1);
    store.add(&key("a"), 3, tile(64), 0.0, 0.0).unwrap();
    store.take_changed();
    // From another vehicle, and from the same one after a restart.
    for (vehicle, index) in [("b", 3), ("a", 3), ("b", 4)] {
        store.add(&key(vehicle), index, tile(0), 1.0, 1.0).unwrap();
    }
    assert!(store.take_changed().is_empty());
    assert_eq!(store.contributions(), 1);
    assert_eq!(store.tiles(&key("b"), 0, 1.0).tiles.len(), 1);
}
