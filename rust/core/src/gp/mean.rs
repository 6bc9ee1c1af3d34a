//! Loops over training points: mean, Jacobian and covariances.

use super::{Covariance, Gp};
use crate::kernel::{ForKernel, Lanes, Metric, Points, Profile, Query};
use crate::simd::{Simd, wide};
use crate::{GpInput, GpJacobian, GpOutput, NY, NZ};

/// [`Gp::mean`].
pub(super) struct Mean<'a> {
    pub gp: &'a Gp,
    pub z: &'a GpInput,
}

impl ForKernel for Mean<'_> {
    type Output = GpOutput;

    /// All outputs in one loop over the points.
    #[inline(always)]
    fn with<P: Profile, S: Simd>(self, simd: S) -> GpOutput {
        let Self { gp, z } = self;
        let [a, b, c] = gp.outputs.each_ref().map(|output| output.weights.iter());
        let points = gp.points.blocks().iter().zip(a.zip(b).zip(c));
        let mut sums = [simd.splat(0.0); NY];
        let mut add = |o: usize, value: S::V, weights: &Lanes| {
            sums[o] = simd.mul_add(value, simd.load(weights), sums[o]);
        };
        if let [Covariance { metric, .. }] = &gp.covariances[..] {
            let query = metric.query(z);
            for ((block, ((a, b), c)), norms) in points.zip(metric.norms()) {
                let value = P::value(simd, query.distances(simd, block, norms));
                for (o, weights) in [a, b, c].into_iter().enumerate() {
                    add(o, value, weights);
                }
            }
        } else {
            let metrics: [&Metric; NY] = std::array::from_fn(|o| &gp.covariances[o].metric);
            let queries = metrics.map(|metric| metric.query(z));
            let norms = metrics.map(Metric::norms);
            for (i, (block, ((a, b), c))) in points.enumerate() {
                for (o, weights) in [a, b, c].into_iter().enumerate() {
                    let distances = queries[o].distances(simd, block, &norms[o][i]);
                    add(o, P::value(simd, distances), weights);
                }
            }
        }
        GpOutput::from_fn(|o, _| gp.outputs[o].constant + simd.sum(sums[o]))
    }
}

/// [`Gp::mean_jacobian`].
pub(super) fn mean_jacobian(gp: &Gp, z: &GpInput, jacobian: &mut GpJacobian) -> GpOutput {
    let weights = gp.outputs.each_ref().map(|output| &output.weights[..]);
    let mut mean = GpOutput::from_fn(|o, _| gp.outputs[o].constant);
    let mut finish = |o: usize, metric: &Metric, sums: &[f64; SUMS]| {
        let [value, slope, moments @ ..] = sums;
        mean[o] += value;
        let scales = metric.inverse_squared_lengthscales();
        for (d, moment) in moments.iter().enumerate() {
            let difference = z[d] * slope - moment;
            jacobian[(o, d)] = 2.0 * gp.kernel.slope() * scales[d] * difference;
        }
    };
    if let [Covariance { metric, .. }] = &gp.covariances[..] {
        let sums = weighted_sums(gp, metric, weights, z);
        (0..NY).for_each(|o| finish(o, metric, &sums[o]));
    } else {
        for (o, Covariance { metric, .. }) in gp.covariances.iter().enumerate() {
            let [sums] = weighted_sums(gp, metric, [weights[o]], z);
            finish(o, metric, &sums);
        }
    }
    mean
}

/// `Σ w φ`, `Σ w φ'` and `Σ w φ' x_d` over the training points.
const SUMS: usize = 2 + NZ;

/// These sums for outputs that share a covariance.
fn weighted_sums<const N: usize>(
    gp: &Gp,
    metric: &Metric,
    weights: [&[Lanes]; N],
    z: &GpInput,
) -> [[f64; SUMS]; N] {
    wide(gp.kernel.with(WeightedSums {
        blocks: gp.points.blocks(),
        norms: metric.norms(),
        query: metric.query(z),
        weights,
    }))
}

#[derive(Clone, Copy)]
struct WeightedSums<'a, const N: usize> {
    blocks: &'a [[Lanes; NZ]],
    norms: &'a [Lanes],
    query: Query,
    weights: [&'a [Lanes]; N],
}

/// Blocks of points whose kernel values are stored between the passes.
const CHUNK: usize = 16;

impl<const N: usize> ForKernel for WeightedSums<'_, N> {
    type Output = [[f64; SUMS]; N];

    #[inline(always)]
    fn with<P: Profile, S: Simd>(self, simd: S) -> [[f64; SUMS]; N] {
        let mut sums = [[simd.splat(0.0); SUMS]; N];
        if S::REGISTERS > N * SUMS {
            self.in_two_passes::<P, S>(simd, &mut sums);
        } else {
            self.in_passes::<P, S>(simd, &mut sums);
        }
        let mut totals = [[0.0; SUMS]; N];
        for (total, sum) in totals
            .as_flattened_mut()
            .iter_mut()
            .zip(sums.as_flattened())
        {
            *total = simd.sum(*sum);
        }
        if P::SLOPE_IS_VALUE {
            for total in &mut totals {
                total[0] = total[1];
            }
        }
        totals
    }
}

impl<const N: usize> WeightedSums<'_, N> {
    /// Kernel values and `Σ w φ` for some blocks of points, then the other sums of all outputs over these blocks: both
    /// passes have registers for their sums, and the first for several blocks of independent operations.
    #[allow(clippy::needless_range_loop)] // the loops read like the sums
    #[inline(always)]
    fn in_two_passes<P: Profile, S: Simd>(self, simd: S, sums: &mut [[S::V; SUMS]; N]) {
        let mut slopes = [simd.splat(0.0); CHUNK];
        let chunks = self.blocks.chunks(CHUNK).zip(self.norms.chunks(CHUNK));
        for (chunk, (blocks, norms)) in chunks.enumerate() {
            let weights = |o: usize, i: usize| simd.load(&self.weights[o][chunk * CHUNK + i]);
            let mut values = sums.map(|sums| sums[0]);
            for (i, (block, norms)) in blocks.iter().zip(norms).enumerate() {
                let distances = self.query.distances(simd, block, norms);
                let (value, slope) = P::value_slope(simd, distances);
                slopes[i] = slope;
                if !P::SLOPE_IS_VALUE {
                    for o in 0..N {
                        values[o] = simd.mul_add(value, weights(o, i), values[o]);
                    }
                }
            }
            let mut others = sums.map(|[_, others @ ..]| others);
            for (i, (block, slope)) in blocks.iter().zip(&slopes).enumerate() {
                let mut weighted = [*slope; N];
                for o in 0..N {
                    weighted[o] = simd.mul(*slope, weights(o, i));
                    others[o][0] = simd.add(others[o][0], weighted[o]);
                }
                // Each coordinate is loaded once for all outputs: with three outputs, loads limit the speed.
                for (d, x) in block.iter().enumerate() {
                    let x = simd.load(x);
                    for o in 0..N {
                        others[o][1 + d] = simd.mul_add(weighted[o], x, others[o][1 + d]);
                    }
                }
            }
            for o in 0..N {
                let [slope, a, b, c, d, e, f] = others[o];
                sums[o] = [values[o], slope, a, b, c, d, e, f];
            }
        }
    }

    /// The same sums in the same order, output by output, for few registers: the moments of one output, which are most of
    /// the work, have them to themselves.
    #[allow(clippy::needless_range_loop)] // the loops read like the sums
    #[inline(always)]
    fn in_passes<P: Profile, S: Simd>(self, simd: S, sums: &mut [[S::V; SUMS]; N]) {
        let mut values = [simd.splat(0.0); CHUNK];
        let mut slopes = [[simd.splat(0.0); CHUNK]; N];
        let chunks = self.blocks.chunks(CHUNK).zip(self.norms.chunks(CHUNK));
        for (chunk, (blocks, norms)) in chunks.enumerate() {
            let weights = |o: usize, i: usize| simd.load(&self.weights[o][chunk * CHUNK + i]);
            for (i, (block, norms)) in blocks.iter().zip(norms).enumerate() {
                let distances = self.query.distances(simd, block, norms);
                let (value, slope) = P::value_slope(simd, distances);
                values[i] = value;
                for o in 0..N {
                    slopes[o][i] = simd.mul(slope, weights(o, i));
                }
            }
            for o in 0..N {
                let [mut value, mut slope, mut moments @ ..] = sums[o];
                for i in 0..blocks.len() {
                    if !P::SLOPE_IS_VALUE {
                        value = simd.mul_add(values[i], weights(o, i), value);
                    }
                    slope = simd.add(slope, slopes[o][i]);
                }
                for (slope, block) in slopes[o].iter().zip(blocks) {
                    for (moment, x) in moments.iter_mut().zip(block) {
                        *moment = simd.mul_add(*slope, simd.load(x), *moment);
                    }
                }
                let [a, b, c, d, e, f] = moments;
                sums[o] = [value, slope, a, b, c, d, e, f];
            }
        }
    }
}

/// Writes `k(z, X)` to `row`, block by block.
pub(super) struct CovarianceRow<'a> {
    pub outputscale: f64,
    pub points: &'a Points,
    /// Norms of the points.
    pub norms: &'a [Lanes],
    pub query: &'a Query,
    pub row: &'a mut [Lanes],
}

impl ForKernel for CovarianceRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with<P: Profile, S: Simd>(self, simd: S) {
        let points = self.points.blocks().iter().zip(self.norms);
        for ((block, norms), covariances) in points.zip(self.row) {
            let value = P::value(simd, self.query.distances(simd, block, norms));
            *covariances = simd.store(simd.mul(simd.splat(self.outputscale), value));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::Kernel;
    use crate::simd::with_each;

    /// One or three outputs with 41 blocks of points, which are more than two chunks and a part.
    fn sums<const N: usize>(kernel: Kernel) -> Vec<[[f64; SUMS]; N]> {
        let number = |i: usize| ((i * 7919) % 1009) as f64 / 500.0 - 1.0;
        let lanes = |first: usize| -> Lanes { std::array::from_fn(|l| number(8 * first + l)) };
        let inputs: Vec<GpInput> = (0..8 * 41)
            .map(|i| GpInput::from_fn(|d, _| number(6 * i + d)))
            .collect();
        let points = Points::new(&inputs);
        let metric = Metric::new(kernel.scale(), &[0.7, 1.1, 0.9, 1.3, 0.8, 1.0], &inputs);
        let weights: [Vec<Lanes>; N] =
            std::array::from_fn(|o| (0..41).map(|i| lanes(1000 * o + i)).collect());
        with_each(kernel.with(WeightedSums {
            blocks: points.blocks(),
            norms: metric.norms(),
            query: metric.query(&GpInput::from_element(0.2)),
            weights: weights.each_ref().map(|weights| &weights[..]),
        }))
    }

    #[test]
    fn instruction_sets_and_numbers_of_passes_agree_bit_by_bit() {
        for kernel in Kernel::ALL {
            let (one, three) = (sums::<1>(kernel), sums::<3>(kernel));
            let bits = |sums: [f64; SUMS]| sums.map(f64::to_bits);
            let portable = three[0].map(bits);
            for (one, three) in one.iter().zip(&three) {
                assert_eq!(bits(one[0]), bits(three[0]));
                assert_eq!(three.map(bits), portable);
            }
        }
    }
}
