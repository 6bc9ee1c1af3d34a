//! The map's store: what it keeps, forgets and returns.
#![allow(clippy::unwrap_used)]

use egp_map::{MergeSettings, TILE_BYTES, Tile};
use egp_service::map::{MapLimits, Store, StoreError};
use egp_wire::road_keys::RoadKey;
use egp_wire::{Code, RoadTiles, TILES_AT_ONCE, WireError};

const LIMITS: MapLimits = MapLimits {
    contributions: 100,
    vehicles: 3,
    tiles: 50,
    roads: 4,
};
const LIFETIME: f64 = 100.0;

fn store() -> Store {
    let merge = MergeSettings {
        lifetime: LIFETIME,
        ..MergeSettings::default()
    };
    Store::new(merge, LIMITS)
}

fn key(vehicle: &str) -> RoadKey {
    RoadKey {
        fleet: "depot".parse().unwrap(),
        vehicle: vehicle.parse().unwrap(),
        road: "ring".parse().unwrap(),
    }
}

/// A tile that excludes all coefficients but one.
fn tile(level: usize) -> Tile {
    let bytes: Vec<u8> = (0..TILE_BYTES)
        .map(|i| if i % 49 == level { 0 } else { 160 })
        .collect();
    Tile::from_bytes(&bytes).unwrap()
}

fn vehicles(tiles: &RoadTiles, index: usize) -> Vec<String> {
    let origins = tiles.tiles[index].origins.iter();
    origins.map(|origin| origin.vehicle.to_string()).collect()
}

#[test]
fn a_vehicle_gets_what_the_others_measured_and_not_its_own() {
    let mut store = store();
    store.add(&key("a"), 0, tile(10), -5.0, 0.0).unwrap();
    assert!(store.tiles(&key("a"), 0, 0.0).tiles.is_empty());
    store.add(&key("b"), 0, tile(10), 0.0, 0.0).unwrap();
    let answer = store.tiles(&key("a"), 0, 1.0);
    assert_eq!(
        (vehicles(&answer, 0), answer.more),
        (vec!["b".to_owned()], false)
    );
    let answer = store.tiles(&key("c"), 0, 1.0);
    assert_eq!(vehicles(&answer, 0), ["a", "b"]);
    assert_eq!(answer.tiles[0].origins[0].age_ms, 6000);
    assert_eq!(RoadTiles::decode(&answer.encode()).unwrap(), answer);
    let other_fleet = RoadKey {
        fleet: "harbour".parse().unwrap(),
        ..key("c")
    };
    assert!(store.tiles(&other_fleet, 0, 1.0).tiles.is_empty());
}

#[test]
fn a_vehicle_has_one_contribution_to_a_tile_and_the_newest_counts() {
    let mut store = store();
    for (level, at) in [(10, 0.0), (20, 5.0), (30, 2.0)] {
        store.add(&key("a"), 0, tile(level), at, 5.0).unwrap();
    }
    assert_eq!(store.contributions(), 1);
    let answer = store.tiles(&key("b"), 0, 5.0);
    assert_eq!(answer.tiles[0].rows[20], 0);
    assert!(answer.tiles[0].rows[30] > 0);
}

#[test]
fn memory_is_bounded() {
    let mut store = store();
    for index in 0..50 {
        store.add(&key("a"), index, tile(1), 0.0, 0.0).unwrap();
    }
    let full = store.add(&key("a"), 50, tile(1), 0.0, 0.0).unwrap_err();
    assert_eq!(full, StoreError::Vehicle(50));
    store.add(&key("a"), 49, tile(2), 1.0, 1.0).unwrap(); // in place of its own
    for index in 0..50 {
        store.add(&key("b"), index, tile(1), 1.0, 1.0).unwrap();
    }
    let full = store.add(&key("c"), 60, tile(1), 1.0, 1.0).unwrap_err();
    assert_eq!(full, StoreError::Full(100));
    let error = WireError::from(full);
    assert!(error.retryable && error.code == Code::Overloaded && error.detail.contains("100"));
    // What is too old makes room.
    store.add(&key("c"), 60, tile(1), 250.0, 250.0).unwrap();
    assert_eq!((store.contributions(), store.roads()), (1, 1));
    store.expire(2000.0);
    assert_eq!((store.contributions(), store.roads()), (0, 0));
}

#[test]
fn a_further_vehicle_replaces_the_oldest_contribution() {
    let mut store = store();
    for (vehicle, at) in [("a", 3.0), ("b", 1.0), ("c", 2.0), ("d", 4.0)] {
        store.add(&key(vehicle), 7, tile(1), at, 4.0).unwrap();
    }
    assert_eq!(
        vehicles(&store.tiles(&key("x"), 0, 4.0), 0),
        ["a", "c", "d"]
    );
    assert_eq!(store.contributions(), 3);
}

#[test]
fn evidence_that_is_older_than_that_of_all_others_replaces_none_of_it() {
    // The same three are kept in whichever order the four come.
    for order in ["abcd", "dcba", "acdb", "bdca"] {
        let mut store = store();
        for vehicle in order.split("").filter(|name| !name.is_empty()) {
            let at = f64::from(vehicle.as_bytes()[0]);
            store.add(&key(vehicle), 7, tile(1), at, 120.0).unwrap();
        }
        let kept = vehicles(&store.tiles(&key("x"), 0, 120.0), 0);
        assert_eq!(kept, ["b", "c", "d"], "{order}");
        assert_eq!(store.contributions(), 3);
    }
}

#[test]
fn a_vehicle_contributes_to_so_many_roads() {
    let mut store = store();
    let on = |vehicle: &str, road: &str| RoadKey {
        road: road.parse().unwrap(),
        ..key(vehicle)
    };
    for road in ["r1", "r2", "r3", "r4"] {
        for index in [0, 1] {
            store.add(&on("a", road), index, tile(1), 0.0, 0.0).unwrap();
        }
    }
    let full = store.add(&on("a", "r5"), 0, tile(1), 0.0, 0.0).unwrap_err();
    assert_eq!(full, StoreError::Roads(4));
    let error = WireError::from(full);
    assert!(!error.retryable && error.code == Code::Overloaded);
    assert!(error.detail.contains("raise `roads`"), "{error}");
    // Others, and further tiles of its own roads, are kept.
    store.add(&on("b", "r5"), 0, tile(1), 0.0, 0.0).unwrap();
    store.add(&on("a", "r4"), 2, tile(1), 200.0, 200.0).unwrap();
    // The other three roads are forgotten.
    store.add(&on("a", "r5"), 0, tile(1), 250.0, 250.0).unwrap();
    assert_eq!((store.contributions(), store.roads()), (2, 2));
}

#[test]
fn vehicles_that_ask_for_room_have_the_store_read_once_a_second() {
    let mut store = store();
    for index in 0..50 {
        store.add(&key("a"), index, tile(1), 0.0, 0.0).unwrap();
    }
    let mut add = |now| store.add(&key("a"), 50, tile(1), now, now);
    let full = Err(StoreError::Vehicle(50));
    assert_eq!(add(248.0), full);
    // What became too old at 100 s · ln 12 = 248.5 s is forgotten at the next look.
    assert_eq!((add(248.6), add(248.9)), (full.clone(), full));
    assert_eq!(add(249.0), Ok(()));
    assert_eq!(store.contributions(), 1);
}

#[test]
fn old_evidence_is_an_error_and_ages_in_answers() {
    let mut store = store();
    let error = store.add(&key("a"), 0, tile(1), 0.0, 249.0).unwrap_err();
    assert!(matches!(error, StoreError::Old { .. }));
    store.add(&key("a"), 0, tile(1), 0.0, 0.0).unwrap();
    let strength = |now| {
        let answer = store.tiles(&key("b"), 0, now);
        f64::from(*answer.tiles[0].rows.iter().max().unwrap()) / 32.0
    };
    assert!((strength(LIFETIME) - strength(0.0) * (-1.0_f64).exp()).abs() < 0.04);
}

#[test]
fn one_question_merges_a_bounded_number_of_tiles_of_others() {
    let mut store = Store::new(
        MergeSettings::default(),
        MapLimits {
            contributions: 1000,
            tiles: 1000,
            ..LIMITS
        },
    );
    // The evidence of `b` is too weak to say anything, except that of the last tile.
    let weak = Tile::from_bytes(&[7, 0].repeat(TILE_BYTES / 2)).unwrap();
    for index in 0..200 {
        store.add(&key("a"), index, tile(1), 0.0, 0.0).unwrap();
        let theirs = if index == 199 { tile(1) } else { weak.clone() };
        store.add(&key("b"), 300 + index, theirs, 0.0, 0.0).unwrap();
    }
    let (mut first, mut answers) = (0, Vec::new());
    loop {
        let answer = store.tiles(&key("a"), first, 0.0);
        assert_eq!(RoadTiles::decode(&answer.encode()).as_ref(), Ok(&answer));
        let last = answer.tiles.last().unwrap();
        answers.push((last.index, last.origins.len()));
        first = last.index + 1;
        if !answer.more {
            break;
        }
    }
    // The 200 tiles that only the asking vehicle has are not merged, and of those of `b` 64 at a time.
    assert_eq!(answers, [(363, 0), (427, 0), (491, 0), (499, 1)]);
    let own = store.tiles(&key("b"), 200, 0.0);
    assert_eq!(own, RoadTiles::default());
}

#[test]
fn long_roads_are_answered_in_parts() {
    let mut store = Store::new(
        MergeSettings::default(),
        MapLimits {
            tiles: 1000,
            ..LIMITS
        },
    );
    for index in 0..70 {
        store.add(&key("a"), 2 * index, tile(1), 0.0, 0.0).unwrap();
    }
    let (mut first, mut found) = (0, Vec::new());
    loop {
        let answer = store.tiles(&key("b"), first, 0.0);
        assert!(answer.tiles.len() <= TILES_AT_ONCE);
        assert!(RoadTiles::decode(&answer.encode()).is_ok());
        found.extend(answer.tiles.iter().map(|tile| tile.index));
        first = found.last().unwrap() + 1;
        if !answer.more {
            break;
        }
    }
    assert_eq!(found, (0..70).map(|index| 2 * index).collect::<Vec<u32>>());
}
