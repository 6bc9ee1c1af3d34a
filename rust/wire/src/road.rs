//! What vehicles measured about a road's friction, on its way to the map service and to other vehicles.

use prost::Message as _;

use crate::keys::Name;
use crate::{Invalid, VERSION, check, proto};

/// Bytes of the rows of a tile.
pub const TILE_BYTES: usize = 64 * 49;
/// Largest number of tiles in an answer.
pub const TILES_AT_ONCE: usize = 32;
/// Largest number of tiles of a road, which is at most 1000 km long.
pub const ROAD_TILES: u32 = 7813;
/// Largest number of vehicles whose evidence is part of a tile.
pub const TILE_ORIGINS: usize = 64;

/// Bytes of a `TileEvidence`, at most.
const EVIDENCE_BYTES: usize = 4096;
/// Bytes of a `RoadTiles`, at most.
const TILES_BYTES: usize = 256 * 1024;

/// What one vehicle measured in a tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileEvidence {
    /// Time since the newest measurement, ms.
    pub age_ms: u32,
    /// The tile's [`TILE_BYTES`] bytes.
    pub rows: Vec<u8>,
}

impl TileEvidence {
    /// Bytes of an `egp.v1.TileEvidence`.
    pub fn encode(&self) -> Vec<u8> {
        proto::TileEvidence {
            version: VERSION,
            age_ms: self.age_ms,
            rows: self.rows.clone(),
        }
        .encode_to_vec()
    }

    /// Reads and validates an `egp.v1.TileEvidence`.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        check::size(bytes, EVIDENCE_BYTES)?;
        let raw = proto::TileEvidence::decode(bytes)?;
        check::version(raw.version)?;
        Ok(Self {
            age_ms: raw.age_ms,
            rows: rows(raw.rows)?,
        })
    }
}

/// A vehicle whose evidence is part of a tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileOrigin {
    /// Name of the vehicle.
    pub vehicle: Name,
    /// Time since its newest measurement, ms.
    pub age_ms: u32,
}

/// What several vehicles measured in a tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RoadTile {
    /// Index of the tile.
    pub index: u32,
    /// The tile's [`TILE_BYTES`] bytes.
    pub rows: Vec<u8>,
    /// The vehicles.
    pub origins: Vec<TileOrigin>,
}

/// Tiles of a road in increasing order of the index.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RoadTiles {
    /// At most [`TILES_AT_ONCE`].
    pub tiles: Vec<RoadTile>,
    /// Whether there are tiles behind the last one. The last one may then be without evidence and origins.
    pub more: bool,
}

impl RoadTiles {
    /// Bytes of an `egp.v1.RoadTiles`.
    pub fn encode(&self) -> Vec<u8> {
        let origin = |origin: &TileOrigin| proto::TileOrigin {
            vehicle: origin.vehicle.to_string(),
            age_ms: origin.age_ms,
        };
        let tile = |tile: &RoadTile| proto::RoadTile {
            index: tile.index,
            rows: tile.rows.clone(),
            origins: tile.origins.iter().map(origin).collect(),
        };
        proto::RoadTiles {
            version: VERSION,
            tiles: self.tiles.iter().map(tile).collect(),
            more: self.more,
        }
        .encode_to_vec()
    }

    /// Reads and validates the answer to a question for the tiles from `first` on.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault, also if there are more tiles and this answer does not say behind which.
    pub fn decode_page(first: u32, bytes: &[u8]) -> Result<Self, Invalid> {
        let answer = Self::decode(bytes)?;
        let end = answer.tiles.last().map(|tile| tile.index);
        if answer.more && end.is_none_or(|end| end < first) {
            let reason = format!("expected tiles from {first} on, since there are more");
            return Err(Invalid::field("tiles", reason));
        }
        Ok(answer)
    }

    /// Reads and validates an `egp.v1.RoadTiles`.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        check::size(bytes, TILES_BYTES)?;
        let raw = proto::RoadTiles::decode(bytes)?;
        check::version(raw.version)?;
        check::at_most(
            "tiles",
            raw.tiles.len(),
            TILES_AT_ONCE,
            "the tiles of one answer",
        )?;
        let tiles: Result<Vec<RoadTile>, Invalid> = raw.tiles.into_iter().map(road_tile).collect();
        let tiles = tiles?;
        let mut pairs = tiles.iter().zip(tiles.iter().skip(1));
        if let Some((before, after)) = pairs.find(|(a, b)| a.index >= b.index) {
            let reason = format!("tile {} stands before tile {}", before.index, after.index);
            return Err(Invalid::field("tiles", reason));
        }
        Ok(Self {
            tiles,
            more: raw.more,
        })
    }
}

/// Bytes of an `egp.v1.TilesChanged`.
pub fn encode_tiles_changed(tiles: Vec<u32>) -> Vec<u8> {
    proto::TilesChanged {
        version: VERSION,
        tiles,
    }
    .encode_to_vec()
}

/// Reads and validates an `egp.v1.TilesChanged`: the indices of tiles with new evidence.
///
/// # Errors
/// [`Invalid`], which names the first field at fault.
pub fn decode_tiles_changed(bytes: &[u8]) -> Result<Vec<u32>, Invalid> {
    check::size(bytes, TILES_BYTES)?;
    let raw = proto::TilesChanged::decode(bytes)?;
    check::version(raw.version)?;
    check::at_most(
        "tiles",
        raw.tiles.len(),
        ROAD_TILES as usize,
        "the longest road",
    )?;
    raw.tiles.iter().try_for_each(|index| tile_index(*index))?;
    Ok(raw.tiles)
}

fn road_tile(raw: proto::RoadTile) -> Result<RoadTile, Invalid> {
    tile_index(raw.index)?;
    check::at_most(
        "origins",
        raw.origins.len(),
        TILE_ORIGINS,
        "the origins of a tile",
    )?;
    let origin = |raw: proto::TileOrigin| {
        let vehicle = raw.vehicle.parse();
        Ok(TileOrigin {
            vehicle: vehicle.map_err(|error| Invalid::field("vehicle", format!("{error}")))?,
            age_ms: raw.age_ms,
        })
    };
    let origins: Result<Vec<TileOrigin>, Invalid> = raw.origins.into_iter().map(origin).collect();
    Ok(RoadTile {
        index: raw.index,
        rows: rows(raw.rows)?,
        origins: origins?,
    })
}

fn rows(bytes: Vec<u8>) -> Result<Vec<u8>, Invalid> {
    if bytes.len() == TILE_BYTES {
        return Ok(bytes);
    }
    let reason = format!("expected {TILE_BYTES} bytes, got {}", bytes.len());
    Err(Invalid::field("rows", reason))
}

fn tile_index(index: u32) -> Result<(), Invalid> {
    let last = ROAD_TILES as usize - 1;
    check::at_most("index", index as usize, last, "the longest road")
}
