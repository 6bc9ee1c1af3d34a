//! The ensemble: weighted mean, Jacobian and variance of the members.

use crate::executor::{Executor, for_each};
use crate::gp::HorizonScratch;
use crate::library::{Library, Member};
use crate::vehicle::Batch;
use crate::{GpInput, GpJacobian, GpOutput};

/// The members with a positive weight, with their weights.
#[derive(Clone, Copy, Debug)]
pub struct Ensemble<'a> {
    members: &'a [Member],
    vehicles: &'a Batch,
    weights: &'a [f64],
}

impl<'a> Ensemble<'a> {
    /// An ensemble of the members with a positive weight. Weights must lie on the simplex, one for each member; further ones are
    /// not used.
    pub fn new(library: &'a Library, weights: &'a [f64]) -> Self {
        Self {
            members: library.members(),
            vehicles: library.vehicles(),
            weights,
        }
    }

    /// The active members with their weights.
    pub fn active(&self) -> impl Iterator<Item = (f64, &'a Member)> {
        self.places().map(|(_, weight, member)| (weight, member))
    }

    /// The active members with their places in the library and their weights.
    fn places(&self) -> impl Iterator<Item = (usize, f64, &'a Member)> {
        let pairs = self.weights.iter().zip(self.members).enumerate();
        pairs
            .filter(|&(_, (&weight, _))| weight > 0.0)
            .map(|(place, (&weight, member))| (place, weight, member))
    }

    /// The mean, eq. (3): `Σ w μ(z)`, in output units.
    pub fn mean(&self, z: &GpInput) -> GpOutput {
        self.active()
            .map(|(weight, member)| weight * member.mean(z))
            .sum()
    }

    /// The mean `Σ w μ(z)` and the slopes for the linearisation of plans, in physical units: `Σ w ∂μ/∂z`, without the GPs of
    /// members that have a single-track vehicle, as `Member::tangent` explains.
    pub fn tangent(&self, z: &GpInput, slopes: &mut GpJacobian) -> GpOutput {
        slopes.fill(0.0);
        let mut mean = GpOutput::zeros();
        let mut own = GpJacobian::zeros();
        let mut vehicles = self.vehicles.tangents(z);
        for (place, weight, member) in self.places() {
            let known = vehicles.change_jacobian(place);
            mean += weight * member.tangent(known, z, &mut own);
            *slopes += weight * own;
        }
        mean
    }

    /// Upper bounds of the variances at all stages of a horizon, in squared output units, at most 22 % above the exact ones
    /// (11 % in standard deviation), at a fraction of their cost. `stage` gives the ensemble of each stage; all are of one
    /// library.
    ///
    /// One member, drawn with the probability `w`, is taken to be true. By the law of total variance the exact variance is
    /// `Σ w (σ² + s²) + Σ w (μ - μ̄)²`, which includes noise `s` and disagreement of the members. The paper's `Σ w² σ²`,
    /// eq. (3), of independent members is optimistic: the measured coverage is below nominal whenever several members share
    /// the weight.
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
            active,
            disagreement,
            members,
        } = scratch;
        active.clear();
        disagreement.clear();
        for (t, z) in z.iter().enumerate() {
            let ensemble = stage(t);
            let several = ensemble.places().nth(1).is_some();
            let (mut sum, mut mean, mut spread) = (0.0, GpOutput::zeros(), GpOutput::zeros());
            for (place, weight, member) in ensemble.places() {
                if let Err(position) = active.binary_search(&place) {
                    active.insert(position, place);
                }
                // The disagreement of a single member is zero.
                if several {
                    sum += weight;
                    disagree(weight, sum, &member.mean(z), &mut mean, &mut spread);
                }
            }
            disagreement.push(spread);
        }
        if members.len() < active.len() {
            members.resize_with(active.len(), MemberScratch::default);
        }
        let library = stage(0).members;
        let squares = |i: &usize| library[*i].n_points() * library[*i].n_points();
        let work = active.iter().map(squares).sum::<usize>() / SQUARES_PER_NANOSECOND;
        let parts = active.iter().zip(&mut *members);
        for_each(executor, work, parts, |(i, memory)| {
            memory.bounds.clear();
            memory.bounds.resize(z.len(), GpOutput::zeros());
            let (horizon, floor) = (&mut memory.horizon, &mut memory.floor);
            library[*i].variance_bounds(z, disagreement, horizon, floor, &mut memory.bounds);
        });
        for (t, (out, disagreement)) in out.iter_mut().zip(disagreement).enumerate() {
            *out = *disagreement;
            for (place, weight, member) in stage(t).places() {
                if let Ok(position) = active.binary_search(&place) {
                    let noise = member.noise_std().map(|std| std * std);
                    *out += weight * (members[position].bounds[t] + noise);
                }
            }
        }
    }
}

/// Memory for [`Ensemble::mixture_bounds`]; grows at its first use and is then reused.
#[derive(Clone, Debug, Default)]
pub struct MixtureScratch {
    /// Places in the library of the members that are active at any stage, ascending.
    active: Vec<usize>,
    disagreement: Vec<GpOutput>,
    members: Vec<MemberScratch>,
}

/// Memory of one member, so that members can be evaluated in parallel.
#[derive(Clone, Debug, Default)]
struct MemberScratch {
    horizon: HorizonScratch,
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
