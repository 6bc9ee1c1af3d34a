//! The ensemble: weighted mean, Jacobian and variance of the members.

use crate::executor::{Executor, for_each};
use crate::gp::Horizon;
use crate::library::{Library, Member};
use crate::vehicle::Batch;
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
    vehicles: &'a Batch,
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
            vehicles: library.vehicles(),
            weights,
            threshold,
            kept: kept / weights.iter().sum::<f64>(),
        })
    }

    /// The ensemble of the same members with other weights, one for each member, of which at least one is above the
    /// threshold.
    pub(crate) fn with_weights(self, weights: &'a [f64]) -> Self {
        let above = weights.iter().filter(|&&weight| weight > self.threshold);
        Self {
            weights,
            kept: above.sum::<f64>() / weights.iter().sum::<f64>(),
            ..self
        }
    }

    /// The share of the weight that was left out, between 0 and 1.
    pub fn dropped_mass(&self) -> f64 {
        1.0 - self.kept
    }

    /// The active members with their scaled weights.
    pub fn active(&self) -> impl Iterator<Item = (f64, &'a Member)> {
        self.places().map(|(_, weight, member)| (weight, member))
    }

    /// The active members with their places in the library and their scaled weights.
    fn places(&self) -> impl Iterator<Item = (usize, f64, &'a Member)> {
        let (threshold, kept) = (self.threshold, self.kept);
        let pairs = self.weights.iter().zip(self.members).enumerate();
        pairs
            .filter(move |&(_, (&weight, _))| weight > threshold)
            .map(move |(place, (&weight, member))| (place, weight / kept, member))
    }

    /// The scaled weight of a member, 0 unless it is active.
    fn share(&self, member: usize) -> f64 {
        let weight = self.weights[member];
        if weight > self.threshold {
            weight / self.kept
        } else {
            0.0
        }
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
        let mut vehicles = self.vehicles.tangents(z);
        for (place, weight, member) in self.places() {
            let known = vehicles.change_jacobian(place);
            mean += weight * member.mean_jacobian_beside(known, z, &mut member_jacobian);
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
    /// (5 % in standard deviation), at a fraction of their cost. `stage` gives the ensemble of each stage; all are of one
    /// library.
    ///
    /// Each member's bound holds relative to its own variance, its noise and the disagreement of the members, whose
    /// weighted sum is the mixture's variance. The executor may evaluate several members in parallel.
    pub fn mixture_bounds(
        stage: impl Fn(usize) -> Self,
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
        let library = stage(0).members;
        let active = || {
            let used = |i: &usize| (0..z.len()).any(|t| stage(t).share(*i) > 0.0);
            (0..library.len()).filter(used)
        };
        let count = active().count();
        // The disagreement of a single member is zero.
        for i in active().filter(|_| count > 1) {
            for (t, (mean, disagreement)) in means.iter_mut().zip(&mut *disagreement).enumerate() {
                let weight = stage(t).share(i);
                if weight > 0.0 {
                    let sum = (0..=i).map(|j| stage(t).share(j)).sum();
                    disagree(weight, sum, &library[i].mean(&z[t]), mean, disagreement);
                }
            }
        }
        out.copy_from_slice(disagreement);
        if members.len() < count {
            members.resize_with(count, MemberScratch::default);
        }
        let squares = |i: usize| library[i].n_points() * library[i].n_points();
        let work = active().map(squares).sum::<usize>() / SQUARES_PER_NANOSECOND;
        let parts = active().zip(&mut *members);
        for_each(executor, work, parts, |(i, memory)| {
            let member = &library[i];
            memory.bounds.clear();
            memory.bounds.resize(z.len(), GpOutput::zeros());
            let (horizon, floor) = (&mut memory.horizon, &mut memory.floor);
            member.variance_bounds(z, disagreement, horizon, floor, &mut memory.bounds);
        });
        for (i, memory) in active().zip(members) {
            let noise = library[i].noise_std().map(|std| std * std);
            for (t, (out, bound)) in out.iter_mut().zip(&memory.bounds).enumerate() {
                *out += stage(t).share(i) * (bound + noise);
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
