//! Merging of the tiles of several vehicles.

use crate::belief_error::{BeliefError, positive};
use crate::grid::LEVELS;
use crate::tile::{TILE_CELLS, Tile, UNITS};

/// Fractions of a tile's unit in which contributions are added. Whole numbers make the sum independent of the order.
const FINER: f64 = 256.0;
/// Smallest logarithm of a likelihood ratio, nats, from which a contribution to a cell counts as informative. Others do not count
/// at all.
const INFORMATIVE: f64 = 0.5;

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
            positive(name, value)?;
        }
        Ok(())
    }

    /// The share of its information that a contribution keeps at an age in s. Clocks that differ a little may give a
    /// negative age, which counts as 0, as does one that is not a number.
    pub fn remaining(&self, age: f64) -> f64 {
        (-age.max(0.0) / self.lifetime).exp()
    }

    /// The age in s from which no contribution counts: even one as strong as the capacity has become uninformative.
    pub fn longest_age(&self) -> f64 {
        self.lifetime * (self.capacity / INFORMATIVE).ln().max(0.0)
    }
}

/// Merges contributions, each with its age in s.
///
/// Logarithms of likelihoods are limited to the capacity and multiplied by `exp(-age / lifetime)`. Of the `n`
/// contributions to a cell that are informative, the `(n - 1) / 2`, rounded down, with the smallest likelihood of a coefficient
/// do not count for it, and the others' logarithms are added: no minority can exclude a coefficient that the others do not
/// exclude. This is a trimmed sum. The result does not depend on the order of the contributions.
pub fn merge<'a>(
    contributions: impl IntoIterator<Item = (&'a Tile, f64)>,
    settings: &MergeSettings,
) -> Tile {
    let limit = settings.capacity * UNITS;
    let aged: Vec<(&[[u8; LEVELS]], f64)> = (contributions.into_iter())
        .map(|(tile, age)| (tile.bytes().as_chunks().0, settings.remaining(age) * FINER))
        .collect();
    let mut informative: Vec<[u64; LEVELS]> = Vec::with_capacity(aged.len());
    let mut column = Vec::with_capacity(aged.len());
    Tile::from_rows((0..TILE_CELLS).map(|cell| {
        informative.clear();
        for (tile, remaining) in &aged {
            let row =
                tile[cell].map(|byte| (f64::from(byte).min(limit) * remaining).round() as u64);
            if row
                .iter()
                .any(|value| *value as f64 >= INFORMATIVE * UNITS * FINER)
            {
                informative.push(row);
            }
        }
        let counted = informative.len() - informative.len().saturating_sub(1) / 2;
        let sums: [u64; LEVELS] = std::array::from_fn(|level| {
            column.clear();
            column.extend(informative.iter().map(|row| row[level]));
            column.sort_unstable();
            column.iter().take(counted).sum()
        });
        let least = sums.iter().copied().min().unwrap_or(0);
        sums.map(|sum| (least as f64 - sum as f64) / (FINER * UNITS))
    }))
}
