//! Exchange of evidence between vehicles: tiles of what this one measured, and tiles of what others reported.

use std::mem::take;

use egp_parameters::FRICTION_HYPOTHESES;

use crate::RoadBelief;
use crate::belief::{BLUR, REACH};
use crate::grid::{interpolate, to_probabilities};
use crate::layer::Layer;
use crate::reported::Reported;
use crate::tile::{TILE_CELLS, Tile};

/// The error about the index of a tile beyond the end of a road.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected a tile in 0..{tiles} of this road, got {index}")]
pub struct TileIndexError {
    index: usize,
    tiles: usize,
}

impl RoadBelief {
    /// Number of tiles of the road; the last one may extend beyond its end.
    pub fn tiles(&self) -> usize {
        self.evidence().len().div_ceil(TILE_CELLS)
    }

    /// What the vehicle itself measured in a tile since the belief was made, without anything that was reported to it or
    /// recalled from a file.
    ///
    /// # Errors
    /// [`TileIndexError`] unless the road has such a tile.
    pub fn tile(&self, index: usize) -> Result<Tile, TileIndexError> {
        self.check(index)?;
        let cells = self.measured().iter().skip(index * TILE_CELLS).copied();
        Ok(Tile::from_rows(cells))
    }

    /// The tiles in which the vehicle measured something since the last call, in order. Windows that do not tell coefficients
    /// apart are no measurements.
    pub fn take_changed(&mut self) -> Vec<usize> {
        take(&mut self.changed).into_iter().collect()
    }

    /// Uses what others reported about a tile, in place of earlier reports about it.
    ///
    /// # Errors
    /// [`TileIndexError`] unless the road has such a tile.
    pub fn report(&mut self, index: usize, tile: &Tile) -> Result<(), TileIndexError> {
        self.check(index)?;
        let cells = self.evidence().len();
        self.reported
            .get_or_insert_with(|| Reported::new(cells))
            .replace(index, tile);
        Ok(())
    }

    /// Probability that the reports describe the road, from what the vehicle measured itself; `None` without reports.
    pub fn trust(&self) -> Option<f64> {
        self.reported.as_ref().map(Reported::trust)
    }

    /// Compares a window's likelihoods with what was reported about the stretch in which the window was measured.
    pub(crate) fn compare_with_reports(&mut self, log_likelihood: &[f64; FRICTION_HYPOTHESES]) {
        let (Some(from), Some(to)) = (self.track.front(), self.track.back()) else {
            return;
        };
        let Some((from, to)) = self.between(*from, *to) else {
            return;
        };
        if self.reported.is_none() || to - from > self.scale() * REACH {
            return;
        }
        let blur = self.scale() * BLUR;
        let (first, last) = (self.index(from - blur), self.index(to + blur));
        let mut stated = self.masses_of(Layer::Reported, first, last, REACH, 0.0);
        stated.iter_mut().for_each(to_probabilities);
        let window = self.window;
        if let Some(reported) = &mut self.reported {
            reported.compare(&stated, &interpolate(log_likelihood), &self.grid, window);
        }
    }

    fn check(&self, index: usize) -> Result<(), TileIndexError> {
        let tiles = self.tiles();
        if index < tiles {
            return Ok(());
        }
        Err(TileIndexError { index, tiles })
    }
}
