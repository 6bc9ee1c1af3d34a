//! What other vehicles reported about a road, and whether it describes the road.

use std::collections::VecDeque;

use crate::grid::{Grid, Row};
use crate::tile::{TILE_CELLS, Tile};

/// Logarithm of the odds that reports describe the road before anything was measured: ln 4, a probability of 0.8. With larger
/// odds more vehicles leave the road at the start on a map that is wrong; with smaller ones they start more slowly on one that
/// is right.
const INITIAL_LOG_ODDS: f64 = 1.386_294_361_119_890_6;
/// Largest magnitude of the logarithm of the odds that earlier windows leave: ln 99, a probability of 0.99. With it one
/// informed window can contradict the reports. The odds for them with the newest window have the same upper bound.
const MOST_LOG_ODDS: f64 = 4.595_119_850_134_59;
/// Share of windows whose estimate may be far off although the reports describe the road.
const OUTLIERS: f64 = 0.01;
/// Share of reports that are lower bounds: a vehicle that used little of the grip measured no upper bound.
const BOUNDS: f64 = 0.5;

/// Likelihoods that were reported for the cells of a road, and the odds that they describe the road.
///
/// They describe it, or they have nothing to do with it. The odds are multiplied by the ratio of the probabilities of
/// what the vehicle measures itself under the two assumptions.
#[derive(Debug, Clone)]
pub(crate) struct Reported {
    /// Likelihoods in each cell.
    pub likelihood: Vec<Row>,
    /// Logarithm of the odds before the present window.
    past: f64,
    /// Logarithm of the odds with the present window.
    present: f64,
    /// Logarithms of the ratios of the windows that overlap with the present one, newest last.
    windows: VecDeque<f64>,
}

impl Reported {
    pub fn new(cells: usize) -> Self {
        Self {
            likelihood: vec![[1.0; _]; cells],
            past: INITIAL_LOG_ODDS,
            present: INITIAL_LOG_ODDS,
            windows: VecDeque::new(),
        }
    }

    /// Replaces the likelihoods of the tile with this index.
    pub fn replace(&mut self, index: usize, tile: &Tile) {
        let cells = self
            .likelihood
            .iter_mut()
            .skip(index.saturating_mul(TILE_CELLS));
        for (row, reported) in cells.zip(tile.likelihoods()) {
            *row = reported;
        }
    }

    /// Adds the windows, of this length, to the odds from before, because later ones have another length.
    pub fn end_windows(&mut self, window: usize) {
        let sum: f64 = self.windows.drain(..).sum();
        self.past = (self.past + sum / window as f64).clamp(-MOST_LOG_ODDS, MOST_LOG_ODDS);
        self.present = self.past;
    }

    /// Probability that the reports describe the road.
    pub fn trust(&self) -> f64 {
        1.0 / (1.0 + (-self.present).exp())
    }

    /// Compares a window's likelihoods with the coefficients that the reports state where it was measured.
    ///
    /// `stated` are the probabilities of the coefficients in the cells there, which count equally, since a border may be
    /// reported a few metres off. Successive windows share all transitions but one: the odds before the present window
    /// contain those that ended before it began, each with the weight `1 / window`, and the present window counts once. A
    /// window changes the logarithm of the odds, in nats, by `r = ln(ε + (1 - ε) Σ q ((1 - β) l + β l̄) / Σ p₀ l)`
    /// (`docs/map.md`, section 3), with the stated probabilities `q`, the likelihoods `l`, those of the coefficient as a
    /// lower bound `l̄`, and the prior `p₀`.
    pub fn compare(&mut self, stated: &[Row], log_likelihood: &Row, grid: &Grid, window: usize) {
        let most = (log_likelihood.iter().copied()).fold(0.0, f64::max);
        let likelihood = log_likelihood.map(|value| (value - most).exp());
        let mean =
            |row: &Row, values: &Row| -> f64 { row.iter().zip(values).map(|(p, v)| p * v).sum() };
        // The window's probability for each coefficient, if that is a lower bound.
        let mut bounded = likelihood;
        let (mut mass, mut sum) = (0.0, 0.0);
        for (value, prior) in bounded.iter_mut().zip(&grid.prior).rev() {
            mass += prior;
            sum += prior * *value;
            *value = sum / mass;
        }
        let given: Row =
            std::array::from_fn(|h| likelihood[h] + BOUNDS * (bounded[h] - likelihood[h]));
        let described =
            stated.iter().map(|row| mean(row, &given)).sum::<f64>() / stated.len() as f64;
        let unrelated = mean(&grid.prior, &likelihood);
        let ratio = (OUTLIERS + (1.0 - OUTLIERS) * described / unrelated).ln();
        if !ratio.is_finite() {
            return; // the window excludes all coefficients
        }
        self.windows.push_back(ratio);
        if self.windows.len() > window
            && let Some(ended) = self.windows.pop_front()
        {
            self.past = (self.past + ended / window as f64).clamp(-MOST_LOG_ODDS, MOST_LOG_ODDS);
        }
        self.present = (self.past + ratio).min(MOST_LOG_ODDS);
    }
}
