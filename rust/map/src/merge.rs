//! The tile that several vehicles together found.

use crate::belief::BeliefError;
use crate::grid::LEVELS;
use crate::tile::{TILE_BYTES, Tile, UNITS};

/// Fractions of a tile's unit in which contributions are added. Whole numbers make the sum independent of the order.
const FINER: f64 = 256.0;

/// How contributions age, and how much each one counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MergeSettings {
    /// Largest logarithm of a likelihood ratio that one vehicle contributes to a cell, in nats.
    pub capacity: f64,
    /// Time in s in which the information of a contribution falls to `1 / e`.
    pub lifetime: f64,
}

impl Default for MergeSettings {
    fn default() -> Self {
        Self {
            capacity: 6.0,
            lifetime: 1800.0,
        }
    }
}

impl MergeSettings {
    /// # Errors
    /// [`BeliefError`] unless both settings are positive and finite.
    pub fn validate(&self) -> Result<(), BeliefError> {
        for (name, value) in [("capacity", self.capacity), ("lifetime", self.lifetime)] {
            crate::belief::positive(name, value)?;
        }
        Ok(())
    }

    /// The share of its information that a contribution keeps at an age in s.
    pub fn remaining(&self, age: f64) -> f64 {
        (-age.max(0.0) / self.lifetime).exp()
    }
}

/// Merges contributions, each with its age in s.
///
/// Logarithms of likelihoods are limited to the capacity, multiplied by `exp(-age / lifetime)` and added. To limit them
/// is to reckon with a vehicle that is wrong with the probability `exp(-capacity)`, and bounds what one vehicle can do: where
/// two contradict a third equally strongly, their coefficient is likelier than the third's by the capacity. The result
/// does not depend on the order of the contributions.
pub fn merge<'a>(
    contributions: impl IntoIterator<Item = (&'a Tile, f64)>,
    settings: &MergeSettings,
) -> Tile {
    let mut sums = vec![0_u64; TILE_BYTES];
    for (tile, age) in contributions {
        let remaining = settings.remaining(age);
        let share = |byte: u8| {
            (f64::from(byte).min(settings.capacity * UNITS) * remaining * FINER).round() as u64
        };
        for (sum, byte) in sums.iter_mut().zip(tile.bytes()) {
            *sum += share(*byte);
        }
    }
    let cells = sums.as_chunks::<LEVELS>().0.iter();
    Tile::from_rows(cells.map(|cell| {
        let least = cell.iter().copied().min().unwrap_or(0);
        cell.map(|sum| (least as f64 - sum as f64) / (FINER * UNITS))
    }))
}
