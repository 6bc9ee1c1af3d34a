//! The weights of each stage, from those of the window and what is known about the friction of the road ahead.

use crate::settings::WeightSettings;
use crate::weights::select_active;
use crate::{GpInput, GpOutput, Member};

/// Largest difference of two frictions that count as the same one, relative to the larger. Interpolation between frictions
/// divides by their difference.
const SAME_FRICTION: f64 = 1e-6;

/// Weights of the active members at each stage of the horizon.
///
/// With `w` the weights of the window, `mu_t` the friction expected at stage `t` and `mu_b` that of the road on which the
/// window was measured,
///
/// ```text
/// w_t ∝ max(0, w + phi(mu_t) - phi(mu_b))
/// ```
///
/// `phi(mu)` interpolates linearly in `mu` between the members with the nearest frictions below and above. Members of the
/// same friction share it in proportion to their weights in `w`, or equally if these are zero. Where the road ahead is
/// expected to be as it was, the weights are those of the window, whatever their relation to the friction.
#[derive(Debug, Clone)]
pub struct StageWeights {
    /// The frictions that differ by more than [`SAME_FRICTION`] in increasing order, each with the indices of its members.
    frictions: Vec<(f64, Vec<usize>)>,
    /// One row `[N]` for each stage, or one row for all of them.
    rows: Vec<f64>,
    row: Vec<f64>,
}

impl StageWeights {
    /// For the members of a library and a horizon of `horizon` periods.
    pub fn new(members: &[Member], horizon: usize) -> Self {
        let n = members.len();
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&a, &b| members[a].friction().total_cmp(&members[b].friction()));
        let friction = |member: usize| members[member].friction();
        let frictions = order
            .chunk_by(|&a, &b| friction(b) - friction(a) <= SAME_FRICTION * friction(b))
            .map(|same| (friction(same[0]), same.to_vec()))
            .collect();
        Self {
            frictions,
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
                self.add(weights, *ahead, 1.0);
                self.add(weights, *behind, -1.0);
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

    /// The smallest friction coefficient of a member.
    pub fn least_friction(&self) -> f64 {
        self.frictions
            .first()
            .map_or(0.0, |(friction, _)| *friction)
    }

    /// The change of the members' mean at `z` by the friction coefficient, from the nearest frictions below and above, or
    /// the two nearest; zero unless two members have different frictions. Members of the same friction count equally.
    pub fn slope(&self, members: &[Member], friction: f64, z: &GpInput) -> GpOutput {
        let mean = |same: &[usize]| {
            let sum = (same.iter()).fold(GpOutput::zeros(), |sum, &i| sum + members[i].mean(z));
            sum / same.len() as f64
        };
        let above = self.frictions.partition_point(|(mu, _)| *mu <= friction);
        let above = above.clamp(1, self.frictions.len().saturating_sub(1).max(1));
        match (self.frictions.get(above - 1), self.frictions.get(above)) {
            (Some((low, a)), Some((high, b))) => (mean(b) - mean(a)) / (high - low),
            _ => GpOutput::zeros(),
        }
    }

    /// Adds `share * phi(friction)`, given the weights `w` of the window.
    fn add(&mut self, weights: &[f64], friction: f64, share: f64) {
        let above = self.frictions.partition_point(|(mu, _)| *mu <= friction);
        let below = self.frictions[..above].last();
        let mut divide = |same: &[usize], share: f64| {
            let sum: f64 = same.iter().map(|&i| weights[i]).sum();
            for &i in same {
                let part = if sum > 0.0 {
                    weights[i] / sum
                } else {
                    1.0 / same.len() as f64
                };
                self.row[i] += share * part;
            }
        };
        match (below, self.frictions.get(above)) {
            (Some((low, a)), Some((high, b))) => {
                let t = (friction - low) / (high - low);
                divide(a, share * (1.0 - t));
                divide(b, share * t);
            }
            (Some((_, only)), None) | (None, Some((_, only))) => divide(only, share),
            (None, None) => {}
        }
    }
}
