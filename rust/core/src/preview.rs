//! The weights of each stage, from those of the window and what is known about the friction of the road ahead.

use crate::settings::WeightSettings;
use crate::weights::select_active;
use crate::{GpInput, GpOutput, Member};

/// Weights of the active members at each stage of the horizon.
///
/// With `w` the weights of the window, `mu_t` the friction expected at stage `t` and `mu_b` that of the road on which the
/// window was measured,
///
/// ```text
/// w_t ∝ max(0, w + phi(mu_t) - phi(mu_b))
/// ```
///
/// `phi(mu)` interpolates linearly in `mu` between the members with the nearest frictions below and above. Where the road
/// ahead is expected to be as it was, the weights are those of the window, whatever their relation to the friction.
#[derive(Debug, Clone)]
pub struct StageWeights {
    /// Frictions of the members with their indices, in increasing order.
    members: Vec<(f64, usize)>,
    /// One row `[N]` for each stage, or one row for all of them.
    rows: Vec<f64>,
    row: Vec<f64>,
}

impl StageWeights {
    /// For the members of a library and a horizon of `horizon` periods.
    pub fn new(members: &[Member], horizon: usize) -> Self {
        let n = members.len();
        let mut frictions: Vec<(f64, usize)> = (members.iter().enumerate())
            .map(|(i, member)| (member.friction(), i))
            .collect();
        frictions.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            members: frictions,
            rows: Vec::with_capacity(n * (horizon + 1)),
            row: vec![0.0; n],
        }
    }

    /// Computes the weights of the stages `0..=T`, or the same weights for all stages if `road` is empty. The rows of
    /// `road` are those of [`StepRequest::road_friction`](crate::StepRequest). Returns the sum of the weights that are left
    /// out at stage 0.
    pub fn fill(&mut self, weights: &[f64], road: &[[f64; 2]], settings: &WeightSettings) -> f64 {
        let n = weights.len();
        let stages = road.len().saturating_sub(1).max(1);
        self.rows.clear();
        self.rows.resize(n * stages, 0.0);
        let mut dropped = 0.0;
        for t in 0..stages {
            self.row.copy_from_slice(weights);
            if let (Some([behind, _]), Some([ahead, _])) = (road.first(), road.get(t + 1))
                && ahead != behind
            {
                self.add(*ahead, 1.0);
                self.add(*behind, -1.0);
                self.row.iter_mut().for_each(|w| *w = w.max(0.0));
                let sum: f64 = self.row.iter().sum();
                self.row.iter_mut().for_each(|w| *w /= sum);
            }
            let active = &mut self.rows[n * t..n * (t + 1)];
            let left = select_active(&self.row, settings.threshold, settings.max_active, active);
            if t == 0 {
                dropped = left;
            }
        }
        dropped
    }

    /// Weights `[N]` of a stage; they sum to one.
    pub fn stage(&self, t: usize) -> &[f64] {
        let n = self.row.len();
        let row = if self.rows.len() > n { t } else { 0 };
        &self.rows[n * row..n * (row + 1)]
    }

    /// The change of the members' mean at `z` by the friction coefficient, from the members with the nearest frictions
    /// below and above, or the two nearest; zero without two members of different frictions.
    pub fn slope(&self, members: &[Member], friction: f64, z: &GpInput) -> GpOutput {
        let above = self.members.partition_point(|(mu, _)| *mu <= friction);
        let above = above.clamp(1, self.members.len().saturating_sub(1).max(1));
        match (self.members.get(above - 1), self.members.get(above)) {
            (Some((low, a)), Some((high, b))) if low < high => {
                (members[*b].mean(z) - members[*a].mean(z)) / (high - low)
            }
            _ => GpOutput::zeros(),
        }
    }

    /// Adds `share * phi(friction)`.
    fn add(&mut self, friction: f64, share: f64) {
        let above = self.members.partition_point(|(mu, _)| *mu <= friction);
        let below = self.members[..above].last();
        match (below, self.members.get(above)) {
            (Some((low, a)), Some((high, b))) => {
                let t = (friction - low) / (high - low);
                self.row[*a] += share * (1.0 - t);
                self.row[*b] += share * t;
            }
            (Some((_, only)), None) | (None, Some((_, only))) => self.row[*only] += share,
            (None, None) => {}
        }
    }
}
