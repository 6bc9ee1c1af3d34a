//! The loops over training points: mean, Jacobian and covariances.

use super::Gp;
use crate::kernel::{Kernel, Lanes, Matern52, Points, Profile, Query, Rbf};
use crate::simd::{Simd, Wide};
use crate::{GpInput, GpJacobian, GpOutput, NY, NZ};

/// [`Gp::mean`].
pub(super) struct Mean<'a> {
    pub gp: &'a Gp,
    pub z: &'a GpInput,
}

impl Mean<'_> {
    #[inline(always)]
    fn with<P: Profile, S: Simd>(self, simd: S) -> GpOutput {
        let outputs = &self.gp.outputs;
        let queries = outputs.each_ref().map(|output| output.metric.query(self.z));
        let [a, b, c] = outputs
            .each_ref()
            .map(|output| output.metric.norms().iter().zip(&output.weights));
        let mut sums = [simd.splat(0.0); NY];
        for (((block, a), b), c) in self.gp.points.blocks().iter().zip(a).zip(b).zip(c) {
            for ((query, sum), (norms, weights)) in queries.iter().zip(&mut sums).zip([a, b, c]) {
                let value = P::value(simd, query.distances(simd, block, norms));
                *sum = simd.mul_add(value, simd.load(weights), *sum);
            }
        }
        GpOutput::from_fn(|o, _| outputs[o].constant + total(simd, sums[o]))
    }
}

impl Wide for Mean<'_> {
    type Output = GpOutput;

    #[inline(always)]
    fn compute<S: Simd>(self, simd: S) -> GpOutput {
        match self.gp.kernel {
            Kernel::Rbf => self.with::<Rbf, S>(simd),
            Kernel::Matern52 => self.with::<Matern52, S>(simd),
        }
    }
}

/// [`Gp::mean_jacobian`].
pub(super) struct MeanJacobian<'a> {
    pub gp: &'a Gp,
    pub z: &'a GpInput,
    pub jacobian: &'a mut GpJacobian,
}

/// The sums over training points of one output.
struct Sums<V> {
    /// `Σ w φ`.
    value: V,
    /// `Σ w φ'`.
    slope: V,
    /// `Σ w φ' x`.
    moment: [V; NZ],
}

impl<V: Copy> Sums<V> {
    #[inline(always)]
    fn zero<S: Simd<V = V>>(simd: S) -> Self {
        let zero = simd.splat(0.0);
        Self {
            value: zero,
            slope: zero,
            moment: [zero; NZ],
        }
    }

    #[inline(always)]
    fn add<P: Profile, S: Simd<V = V>>(
        &mut self,
        simd: S,
        query: &Query,
        (block, norms, weights): (&[Lanes; NZ], &Lanes, &Lanes),
    ) {
        let (value, slope) = P::value_slope(simd, query.distances(simd, block, norms));
        let weights = simd.load(weights);
        let slope = simd.mul(slope, weights);
        self.value = simd.add(self.value, simd.mul(value, weights));
        self.slope = simd.add(self.slope, slope);
        for (moment, x) in self.moment.iter_mut().zip(block) {
            *moment = simd.mul_add(slope, simd.load(x), *moment);
        }
    }
}

impl MeanJacobian<'_> {
    /// One output after the other: the eight sums stay in registers.
    #[inline(always)]
    fn with<P: Profile, S: Simd>(self, simd: S) -> GpOutput {
        let Self { gp, z, jacobian } = self;
        let mut mean = GpOutput::zeros();
        for (o, output) in gp.outputs.iter().enumerate() {
            let query = output.metric.query(z);
            let mut sums = Sums::zero(simd);
            let points = gp.points.blocks().iter().zip(output.metric.norms());
            for ((block, norms), weights) in points.zip(&output.weights) {
                sums.add::<P, S>(simd, &query, (block, norms, weights));
            }
            mean[o] = output.constant + total(simd, sums.value);
            let slope = total(simd, sums.slope);
            let scales = output.metric.inverse_squared_lengthscales();
            for d in 0..NZ {
                let difference = z[d] * slope - total(simd, sums.moment[d]);
                jacobian[(o, d)] = 2.0 * P::SLOPE * scales[d] * difference;
            }
        }
        mean
    }
}

impl Wide for MeanJacobian<'_> {
    type Output = GpOutput;

    #[inline(always)]
    fn compute<S: Simd>(self, simd: S) -> GpOutput {
        match self.gp.kernel {
            Kernel::Rbf => self.with::<Rbf, S>(simd),
            Kernel::Matern52 => self.with::<Matern52, S>(simd),
        }
    }
}

/// `k(z, X)` of one output, block by block.
pub(super) struct CovarianceRow<'a> {
    pub kernel: Kernel,
    pub outputscale: f64,
    pub points: &'a Points,
    /// Of the points.
    pub norms: &'a [Lanes],
    pub query: &'a Query,
    pub row: &'a mut [Lanes],
}

impl CovarianceRow<'_> {
    #[inline(always)]
    fn with<P: Profile, S: Simd>(self, simd: S) {
        let points = self.points.blocks().iter().zip(self.norms);
        for ((block, norms), covariances) in points.zip(self.row) {
            let value = P::value(simd, self.query.distances(simd, block, norms));
            *covariances = simd.store(simd.mul(simd.splat(self.outputscale), value));
        }
    }
}

impl Wide for CovarianceRow<'_> {
    type Output = ();

    #[inline(always)]
    fn compute<S: Simd>(self, simd: S) {
        match self.kernel {
            Kernel::Rbf => self.with::<Rbf, S>(simd),
            Kernel::Matern52 => self.with::<Matern52, S>(simd),
        }
    }
}

/// The sum over the lanes, always in the same order.
#[inline(always)]
fn total<S: Simd>(simd: S, sum: S::V) -> f64 {
    simd.store(sum).iter().sum()
}
