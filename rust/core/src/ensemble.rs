//! The ensemble: weighted mean, Jacobian and variance of the members.

use crate::executor::{Executor, for_each};
use crate::gp::Horizon;
use crate::library::{Library, Member};
use crate::{GpInput, GpJacobian, GpOutput, VarianceScratch};

/// Weights that do not define an ensemble.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EnsembleError {
    /// The number of weights differs from the number of members.
    #[error("expected {expected} weights, one for each member, got {found}")]
    WeightCount {
        /// Number of members.
        expected: usize,
        /// Number of weights.
        found: usize,
    },
    /// No weight is above the threshold, so no member is active.
    #[error(
        "no weight is above the threshold {threshold}; with N members choose a threshold below 1/N"
    )]
    NoActiveMember {
        /// The threshold.
        threshold: f64,
    },
}

/// Variance of the ensemble under two assumptions, in squared output units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnsembleVariance {
    /// The members are independent random variables, eq. (3): `Σ w² σ²`. This is optimistic: the measured coverage is
    /// below nominal whenever several members share the weight.
    pub independent: GpOutput,
    /// One member, drawn with probability `w`, is true. By the law of total variance this is
    /// `Σ w (σ² + s²) + Σ w (μ - μ̄)²`, which includes noise and disagreement of the members. Use it for constraints.
    pub mixture: GpOutput,
}

/// The members whose weight exceeds a threshold, with their weights.
#[derive(Clone, Copy, Debug)]
pub struct Ensemble<'a> {
    members: &'a [Member],
    weights: &'a [f64],
    threshold: f64,
    kept: f64,
}

impl<'a> Ensemble<'a> {
    /// An ensemble of the members with a weight above `threshold`; their weights are scaled to the sum of all weights.
    ///
    /// Weights must lie on the simplex. A `threshold` of zero keeps every positive weight.
    ///
    /// # Errors
    /// [`EnsembleError::WeightCount`], [`EnsembleError::NoActiveMember`].
    pub fn new(
        library: &'a Library,
        weights: &'a [f64],
        threshold: f64,
    ) -> Result<Self, EnsembleError> {
        let members = library.members();
        if weights.len() != members.len() {
            return Err(EnsembleError::WeightCount {
                expected: members.len(),
                found: weights.len(),
            });
        }
        let kept: f64 = weights.iter().filter(|&&weight| weight > threshold).sum();
        if kept.is_nan() || kept <= 0.0 {
            return Err(EnsembleError::NoActiveMember { threshold });
        }
        Ok(Self {
            members,
            weights,
            threshold,
            kept: kept / weights.iter().sum::<f64>(),
        })
    }

    /// The share of the weight that was left out, between 0 and 1.
    pub fn dropped_mass(&self) -> f64 {
        1.0 - self.kept
    }

    /// The active members with their scaled weights.
    pub fn active(&self) -> impl Iterator<Item = (f64, &'a Member)> {
        let (threshold, kept) = (self.threshold, self.kept);
        let pairs = self.weights.iter().zip(self.members);
        pairs
            .filter(move |&(&weight, _)| weight > threshold)
            .map(move |(&weight, member)| (weight / kept, member))
    }

    /// The mean, eq. (3): `Σ w μ(z)`, in output units.
    pub fn mean(&self, z: &GpInput) -> GpOutput {
        self.active()
            .map(|(weight, member)| weight * member.mean(z))
            .sum()
    }

    /// The mean and its Jacobian: `Σ w μ(z)`, `Σ w ∂μ/∂z`, in physical units.
    pub fn mean_jacobian(&self, z: &GpInput, jacobian: &mut GpJacobian) -> GpOutput {
        jacobian.fill(0.0);
        let mut mean = GpOutput::zeros();
        let mut member_jacobian = GpJacobian::zeros();
        for (weight, member) in self.active() {
            mean += weight * member.mean_jacobian(z, &mut member_jacobian);
            *jacobian += weight * member_jacobian;
        }
        mean
    }

    /// Both variances at `z`.
    pub fn variance(&self, z: &GpInput, scratch: &mut VarianceScratch) -> EnsembleVariance {
        let mut independent = GpOutput::zeros();
        let mut mixture = GpOutput::zeros();
        let (mut sum, mut mean) = (0.0, GpOutput::zeros());
        for (weight, member) in self.active() {
            let variance = member.variance(z, scratch);
            independent += weight * weight * variance;
            mixture += weight * (variance + member.noise_std().map(|std| std * std));
            sum += weight;
            disagree(weight, sum, &member.mean(z), &mut mean, &mut mixture);
        }
        EnsembleVariance {
            independent,
            mixture,
        }
    }

    /// Upper bounds of [`EnsembleVariance::mixture`] at all stages of a horizon, at most 10 % above the exact ones
    /// (5 % in standard deviation), at a fraction of their cost.
    ///
    /// Each member's bound holds relative to its own variance, its noise and the disagreement of the members, whose
    /// weighted sum is the mixture's variance. The executor may evaluate several members in parallel.
    pub fn mixture_bounds(
        &self,
        z: &[GpInput],
        scratch: &mut MixtureScratch,
        out: &mut [GpOutput],
        executor: &dyn Executor,
    ) {
        let MixtureScratch {
            means,
            disagreement,
            members,
        } = scratch;
        for buffer in [&mut *means, &mut *disagreement] {
            buffer.clear();
            buffer.resize(z.len(), GpOutput::zeros());
        }
        let mut sum = 0.0;
        let several = self.active().nth(1).is_some(); // the disagreement of a single member is zero
        for (weight, member) in self.active().filter(|_| several) {
            sum += weight;
            for ((z, mean), disagreement) in z.iter().zip(&mut *means).zip(&mut *disagreement) {
                disagree(weight, sum, &member.mean(z), mean, disagreement);
            }
        }
        out.copy_from_slice(disagreement);
        let active = self.active().count();
        if members.len() < active {
            members.resize_with(active, MemberScratch::default);
        }
        let squares = |(_, member): (f64, &Member)| member.n_points() * member.n_points();
        let work = self.active().map(squares).sum::<usize>() / SQUARES_PER_NANOSECOND;
        let parts = self.active().zip(&mut *members);
        for_each(executor, work, parts, |((_, member), memory)| {
            memory.bounds.clear();
            memory.bounds.resize(z.len(), GpOutput::zeros());
            let (horizon, floor) = (&mut memory.horizon, &mut memory.floor);
            member.variance_bounds(z, disagreement, horizon, floor, &mut memory.bounds);
        });
        for ((weight, member), memory) in self.active().zip(members) {
            let noise = member.noise_std().map(|std| std * std);
            for (out, bound) in out.iter_mut().zip(&memory.bounds) {
                *out += weight * (bound + noise);
            }
        }
    }
}

/// Memory for [`Ensemble::mixture_bounds`]; grows at its first use and is then reused.
#[derive(Clone, Debug, Default)]
pub struct MixtureScratch {
    means: Vec<GpOutput>,
    disagreement: Vec<GpOutput>,
    members: Vec<MemberScratch>,
}

/// Memory of one member, so that members can be evaluated in parallel.
#[derive(Clone, Debug, Default)]
struct MemberScratch {
    horizon: Horizon,
    floor: Vec<GpOutput>,
    bounds: Vec<GpOutput>,
}

/// Approximate work per nanosecond, in squared numbers of training points.
const SQUARES_PER_NANOSECOND: usize = 4;

/// West's one-pass update of weighted mean and disagreement, which avoids cancellation. `sum` is the sum of the weights
/// so far, including this member's.
fn disagree(
    weight: f64,
    sum: f64,
    member_mean: &GpOutput,
    mean: &mut GpOutput,
    disagreement: &mut GpOutput,
) {
    let before = member_mean - *mean;
    *mean += before * (weight / sum);
    *disagreement += weight * before.component_mul(&(member_mean - *mean));
}
