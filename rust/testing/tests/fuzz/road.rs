//! Messages and keys of the map service.

use egp_wire::road_keys::{self, RoadTarget};
use egp_wire::{
    ROAD_TILES, RoadTile, RoadTiles, TILE_BYTES, TileEvidence, TileOrigin, decode_tiles_changed,
    encode_tiles_changed,
};

use crate::edits::Words;
use crate::fuzz;

fn evidence() -> Vec<u8> {
    let rows = (0..=255).cycle().take(TILE_BYTES).collect();
    TileEvidence { age_ms: 700, rows }.encode()
}

fn tiles() -> Vec<u8> {
    let tile = |index| RoadTile {
        index,
        rows: vec![7; TILE_BYTES],
        origins: vec![TileOrigin {
            vehicle: "car-1".parse().unwrap(),
            age_ms: 12,
        }],
    };
    RoadTiles {
        tiles: vec![tile(3), tile(4)],
        more: true,
    }
    .encode()
}

#[test]
fn accepted_evidence_encodes_to_itself() {
    fuzz!([evidence()], Words::Doubles, |bytes: Vec<u8>| {
        if let Ok(evidence) = TileEvidence::decode(&bytes) {
            assert_eq!(evidence.rows.len(), TILE_BYTES);
            assert_eq!(TileEvidence::decode(&evidence.encode()).unwrap(), evidence);
        }
    });
}

#[test]
fn accepted_tiles_are_in_order_and_encode_to_themselves() {
    fuzz!([tiles()], Words::Doubles, |bytes: Vec<u8>| {
        if let Ok(answer) = RoadTiles::decode(&bytes) {
            assert!(answer.tiles.is_sorted_by(|a, b| a.index < b.index));
            assert!(
                answer
                    .tiles
                    .iter()
                    .all(|tile| tile.rows.len() == TILE_BYTES)
            );
            assert_eq!(RoadTiles::decode(&answer.encode()).unwrap(), answer);
        }
    });
}

#[test]
fn accepted_changes_are_tiles_of_a_road() {
    let example = encode_tiles_changed(vec![0, 5, ROAD_TILES - 1]);
    fuzz!([example], Words::Doubles, |bytes: Vec<u8>| {
        if let Ok(changed) = decode_tiles_changed(&bytes) {
            assert!(changed.iter().all(|index| *index < ROAD_TILES));
        }
    });
}

#[test]
fn an_accepted_key_is_the_one_that_is_written() {
    let examples = [
        "egp/v1/map/depot/car-7/ring/tile/3",
        "egp/v1/map/d/c/r/tiles/0",
    ];
    let examples = examples.map(|key| key.as_bytes().to_vec());
    fuzz!(examples, Words::Doubles, |bytes: Vec<u8>| {
        let Ok(key) = String::from_utf8(bytes) else {
            return;
        };
        let index = key.rsplit('/').next().unwrap_or_default();
        if index.len() > 1 && index.starts_with('0') {
            return; // leading zeros are read and not written
        }
        match road_keys::parse(&key) {
            Some(RoadTarget::Tile(road, index)) => assert_eq!(road.tile(index), key),
            Some(RoadTarget::Tiles(road, index)) => assert_eq!(road.tiles(index), key),
            _ => {}
        }
    });
}
