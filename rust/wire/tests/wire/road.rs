//! Messages about a road's friction are read as they were written, and have limits.

use egp_wire::{
    ROAD_TILES, RoadTile, RoadTiles, TILE_BYTES, TILE_ORIGINS, TILES_AT_ONCE, TileEvidence,
    TileOrigin, decode_tiles_changed, encode_tiles_changed,
};

fn rows() -> Vec<u8> {
    (0..=250).cycle().take(TILE_BYTES).collect()
}

fn tile(index: u32, origins: usize) -> RoadTile {
    let origin = |k| TileOrigin {
        vehicle: format!("car-{k:058}").parse().unwrap(),
        age_ms: u32::MAX,
    };
    RoadTile {
        index,
        rows: rows(),
        origins: (0..origins).map(origin).collect(),
    }
}

fn tiles(indices: impl IntoIterator<Item = u32>) -> RoadTiles {
    RoadTiles {
        tiles: indices.into_iter().map(|index| tile(index, 0)).collect(),
        more: true,
    }
}

/// The reason why an answer of the map service is not read.
fn reason(tiles: &RoadTiles) -> String {
    RoadTiles::decode(&tiles.encode()).unwrap_err().to_string()
}

#[test]
fn evidence_is_read_as_it_was_written() {
    let evidence = TileEvidence {
        age_ms: 17,
        rows: rows(),
    };
    assert_eq!(
        evidence.rows.len(),
        3136,
        "64 cells of 49 bytes (docs/map.md)"
    );
    assert_eq!(TileEvidence::decode(&evidence.encode()), Ok(evidence));
    for length in [0, TILE_BYTES - 1, TILE_BYTES + 1] {
        let other = TileEvidence {
            age_ms: 17,
            rows: vec![1; length],
        };
        let error = TileEvidence::decode(&other.encode()).unwrap_err();
        assert!(
            error.to_string().contains(&format!("got {length}")),
            "{error}"
        );
    }
}

#[test]
fn the_largest_answer_of_the_map_service_is_read() {
    let last = ROAD_TILES - 1;
    let first = ROAD_TILES - u32::try_from(TILES_AT_ONCE).unwrap();
    let full = RoadTiles {
        tiles: (first..=last)
            .map(|index| tile(index, TILE_ORIGINS))
            .collect(),
        more: false,
    };
    assert_eq!(RoadTiles::decode(&full.encode()), Ok(full));
    assert_eq!(
        RoadTiles::decode(&tiles([2, 3]).encode()),
        Ok(tiles([2, 3]))
    );
}

#[test]
fn tiles_are_in_order_on_the_road_and_not_too_many() {
    assert!(reason(&tiles([3, 2])).contains("tile 3 stands before tile 2"));
    assert!(reason(&tiles([1, 2, 2])).contains("tile 2 stands before tile 2"));
    assert!(reason(&tiles([ROAD_TILES])).contains("the longest road"));
    let many = u32::try_from(TILES_AT_ONCE).unwrap() + 1;
    assert!(
        reason(&tiles(0..many)).contains("expected at most 32 (the tiles of one answer), got 33")
    );
    let crowded = RoadTiles {
        tiles: vec![tile(0, TILE_ORIGINS + 1)],
        more: false,
    };
    assert!(reason(&crowded).contains("expected at most 64 (the origins of a tile), got 65"));
}

#[test]
fn messages_beyond_their_size_are_not_read() {
    // Unknown fields are skipped, so that only the size is at fault.
    let padded = |mut bytes: Vec<u8>, length: usize| {
        // Field 15 with as many bytes as are missing, a number that takes three bytes.
        let rest = length - bytes.len() - 4;
        let septets = [rest & 0x7f | 0x80, rest >> 7 & 0x7f | 0x80, rest >> 14];
        bytes.push(0x7a);
        bytes.extend(septets.map(|septet| u8::try_from(septet).unwrap()));
        bytes.resize(length, 0);
        bytes
    };
    let evidence = TileEvidence {
        age_ms: 0,
        rows: rows(),
    };
    assert!(TileEvidence::decode(&padded(evidence.encode(), 4096)).is_ok());
    assert!(TileEvidence::decode(&padded(evidence.encode(), 4097)).is_err());
    assert!(RoadTiles::decode(&padded(tiles([1]).encode(), 256 * 1024)).is_ok());
    assert!(RoadTiles::decode(&padded(tiles([1]).encode(), 256 * 1024 + 1)).is_err());
}

#[test]
fn changed_tiles_are_on_the_road() {
    let changed = vec![0, 7, ROAD_TILES - 1];
    assert_eq!(
        decode_tiles_changed(&encode_tiles_changed(changed.clone())),
        Ok(changed)
    );
    let beyond = encode_tiles_changed(vec![ROAD_TILES]);
    assert!(decode_tiles_changed(&beyond).is_err());
    let all = vec![0; ROAD_TILES as usize];
    assert!(decode_tiles_changed(&encode_tiles_changed(all)).is_ok());
    let more = vec![0; ROAD_TILES as usize + 1];
    assert!(decode_tiles_changed(&encode_tiles_changed(more)).is_err());
}
