//! The content of a road's file.

use std::collections::BTreeMap;

use egp_map::TILE_BYTES;
use egp_wire::{VERSION, proto};
use prost::Message;
use ring::digest::{SHA256, digest};

use super::file::Clocks;
use super::store::{Road, Tiles};

/// At least as many bytes as a contribution takes in a file, whose vehicle's name has up to 64 characters.
const LARGEST_EVIDENCE: usize = TILE_BYTES + 128;

/// The content of a road's file without its checksum. Protobuf reads messages one behind the other as one message with the
/// fields of all, so that no second copy of all tiles is needed.
pub(crate) fn encode((fleet, name): &Road, tiles: &Tiles, clocks: Clocks) -> Vec<u8> {
    let road = proto::StoredRoad {
        version: VERSION,
        fleet: fleet.to_string(),
        road: name.to_string(),
        ..proto::StoredRoad::default()
    };
    let count: usize = tiles.values().map(BTreeMap::len).sum();
    let mut bytes = Vec::with_capacity(count * LARGEST_EVIDENCE + 2 * LARGEST_EVIDENCE);
    bytes.extend(road.encode_to_vec());
    for (tile, vehicles) in tiles {
        for (vehicle, contribution) in vehicles {
            let age = age_ms(clocks.now - contribution.at);
            let evidence = proto::StoredEvidence {
                tile: *tile,
                vehicle: vehicle.to_string(),
                measured_ms: clocks.unix_ms.saturating_sub(age),
                rows: contribution.tile.bytes().to_vec(),
            };
            let evidence = proto::StoredRoad {
                evidence: vec![evidence],
                ..proto::StoredRoad::default()
            };
            bytes.extend(evidence.encode_to_vec());
        }
    }
    bytes
}

/// Adds the checksum to the content of a road's file. It takes seconds for a long road.
pub(crate) fn with_checksum(mut bytes: Vec<u8>) -> Vec<u8> {
    let checksum = proto::StoredRoad {
        sha256: digest(&SHA256, &bytes).as_ref().to_vec(),
        ..proto::StoredRoad::default()
    };
    bytes.extend(checksum.encode_to_vec());
    bytes
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a cast of floats saturates
fn age_ms(seconds: f64) -> u64 {
    (1e3 * seconds.max(0.0)) as u64
}
