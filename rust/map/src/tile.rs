//! The evidence about one stretch of a road, in the form in which vehicles exchange it.

use crate::grid::{LEVELS, Row};

/// Number of cells of a tile.
pub const TILE_CELLS: usize = 64;
/// Number of bytes of a tile: one for each friction coefficient of each cell.
pub const TILE_BYTES: usize = TILE_CELLS * LEVELS;
/// Number of units of a byte in one nat.
pub(crate) const UNITS: f64 = 32.0;

/// The error about bytes whose number is not that of a tile.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected a tile of {TILE_BYTES} bytes ({TILE_CELLS} cells of {LEVELS} friction coefficients), got {0} bytes"
)]
pub struct TileError(usize);

/// The likelihoods of the friction coefficients in [`TILE_CELLS`] cells of a road.
///
/// Each is a byte `b` and stands for the logarithm `-b / 32` nats, relative to the likeliest coefficient of the cell. The
/// form bounds the content of a tile: no number is missing, infinite or not a number, and no ratio of likelihoods exceeds
/// 8 nats. Rounding changes a logarithm by at most 1/64 nat.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tile(Vec<u8>);

impl Tile {
    /// Reads a tile. The smallest byte of each cell is subtracted from the cell's bytes, since only ratios of likelihoods
    /// matter.
    ///
    /// # Errors
    /// [`TileError`] unless there are [`TILE_BYTES`] bytes.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TileError> {
        if bytes.len() != TILE_BYTES {
            return Err(TileError(bytes.len()));
        }
        let mut tile = bytes.to_vec();
        for cell in tile.chunks_exact_mut(LEVELS) {
            let least = cell.iter().copied().min().unwrap_or(0);
            for byte in cell {
                *byte -= least;
            }
        }
        Ok(Self(tile))
    }

    /// A tile of logarithms in nats, the largest of each row 0; all coefficients of a cell without a row are equally likely.
    pub(crate) fn from_rows(rows: impl IntoIterator<Item = Row>) -> Self {
        let mut tile = vec![0; TILE_BYTES];
        for (cell, row) in tile.chunks_exact_mut(LEVELS).zip(rows) {
            for (byte, value) in cell.iter_mut().zip(row) {
                *byte = (-value * UNITS).round().clamp(0.0, 255.0) as u8;
            }
        }
        Self(tile)
    }

    /// The bytes, from which [`Self::from_bytes`] makes the same tile.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Whether all coefficients are equally likely in each cell.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|byte| *byte == 0)
    }

    /// The likelihoods of each cell.
    pub(crate) fn likelihoods(&self) -> impl Iterator<Item = Row> {
        self.0
            .as_chunks::<LEVELS>()
            .0
            .iter()
            .map(|cell| cell.map(|byte| (-f64::from(byte) / UNITS).exp()))
    }
}
