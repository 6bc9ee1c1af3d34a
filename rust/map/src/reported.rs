//! What other vehicles reported about a road, and whether it describes the road.

use std::collections::VecDeque;

use crate::grid::{Grid, Row, to_probabilities};
use crate::tile::{TILE_CELLS, Tile};

/// Logarithm of the odds that reports describe the road before anything was measured: 1 to 1. With larger odds more vehicles
/// leave the road at the start on a map that is wrong; with smaller ones they start more slowly on one that is right.
const INITIAL_LOG_ODDS: f64 = 0.0;
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

    /// Adds the windows, of this length, to the odds from before, because later ones do not overlap with them.
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
    /// window changes the logarithm of the odds, in nats, by `r = ln(ε + (1 - ε) Σ ((1 - β) q + β q̄) l / Σ p₀ l)`
    /// (`docs/map.md`, section 3), with the stated probabilities `q`, those if they are lower bounds `q̄`, the likelihoods
    /// `l` and the prior `p₀`. Where nothing was reported, `q` and `q̄` are the prior, and the odds stay as they are.
    pub fn compare(&mut self, stated: &[Row], log_likelihood: &Row, grid: &Grid, window: usize) {
        let most = (log_likelihood.iter().copied()).fold(0.0, f64::max);
        let likelihood = log_likelihood.map(|value| (value - most).exp());
        let mean = |row: &Row| -> f64 { row.iter().zip(&likelihood).map(|(p, l)| p * l).sum() };
        let described = |row: &Row| {
            (1.0 - BOUNDS) * mean(row) + BOUNDS * mean(&as_lower_bounds(row, &grid.prior))
        };
        let described = stated.iter().map(described).sum::<f64>() / stated.len() as f64;
        let unrelated = mean(&grid.prior);
        let ratio = (OUTLIERS + (1.0 - OUTLIERS) * described / unrelated).ln();
        self.windows.push_back(ratio);
        if self.windows.len() > window
            && let Some(ended) = self.windows.pop_front()
        {
            self.past = (self.past + ended / window as f64).clamp(-MOST_LOG_ODDS, MOST_LOG_ODDS);
        }
        self.present = (self.past + ratio).min(MOST_LOG_ODDS);
    }
}

/// The probabilities of the coefficients if the stated ones are lower bounds: `q̄ ∝ p₀ max(q / p₀)` with the maximum over all
/// smaller or equal coefficients. A single stated coefficient becomes the prior above it, and the prior stays the prior.
fn as_lower_bounds(stated: &Row, prior: &Row) -> Row {
    let mut most = 0.0_f64;
    let mut bounds = *stated;
    for (value, prior) in bounds.iter_mut().zip(prior) {
        most = most.max(*value / prior);
        *value = prior * most;
    }
    to_probabilities(&mut bounds);
    bounds
}
