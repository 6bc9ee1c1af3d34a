//! Bounds of the variance at all stages of a horizon from a few of them.

use super::mean::CovarianceRow;
use super::{Covariance, Gp};
use crate::cholesky::{add_scaled, axpy, dots};
use crate::kernel::{LANES, Lanes, Points};
use crate::simd::{Vectorised, vectorised_loops, wide};
use crate::{GpInput, GpOutput};

/// Largest excess of a bound over the variance `q` that the nodes explain, relative to `q` plus floor (see
/// [`Gp::variance_bounds`]). The exact variance may be below `q` by as much, so that in the worst case a bound is 22 % and
/// its standard deviation 11 % too large.
pub(crate) const TOLERANCE: f64 = 0.1;
/// Smallest residual prior variance of a new node as a multiple of the outputscale; below it are rounding errors only.
const SMALLEST_PIVOT: f64 = 1e-12;

/// Memory of [`Gp::variance_bounds`].
#[derive(Clone, Debug, Default)]
pub(crate) struct HorizonScratch {
    /// Z-scored queries, filled by the caller.
    pub z: Vec<GpInput>,
    queries: Points,
    norms: Vec<Lanes>,
    /// Stages used as nodes, in the order of selection.
    nodes: Vec<usize>,
    /// `l(z)`: a row over the stages for each node.
    factor: Vec<f64>,
    /// `rho(z)` of each stage.
    residual: Vec<f64>,
    /// `q(z)` of each stage.
    variance: Vec<f64>,
    /// Covariances of a node with the stages.
    row: Vec<Lanes>,
    /// `k(X, z)` of the nodes, one after the other.
    covariances: Vec<Lanes>,
    /// `L⁻¹ k(X, z)` of the nodes, one after the other.
    whitened: Vec<Lanes>,
    /// `G`; rows are as long as the number of stages.
    gram: Vec<f64>,
    /// `c(z)`: a row over the stages for each node.
    coefficients: Vec<f64>,
    /// One component of `G c` at all stages.
    explained: Vec<f64>,
}

impl Gp {
    /// Upper bounds of the variances at the z-scored inputs `scratch.z`, in z-scored units, each at most `TOLERANCE ·
    /// (q + floor)` above the estimate `q` below, where `floor` is the variance that the caller adds to the bound.
    /// Outputs that share a covariance use the smallest of their floors.
    ///
    /// Stages lie on a curve, so the values of the latent function at a few of them, the nodes `N`, nearly determine
    /// the others. Given noise-free values `f_N`, at any stage `f(z) = k(z, N) K_NN⁻¹ f_N + e`, where `e` has the prior
    /// variance `ρ(z) = k(z, z) - k(z, N) K_NN⁻¹ k(N, z)`. Data can only lower this variance, and by Cauchy-Schwarz
    /// ```text
    /// √q - √ρ <= σ(z) <= √q + √ρ,     q = l(z)ᵀ l(z) - c(z)ᵀ G c(z),
    /// R Rᵀ = K_NN,   l(z) = R⁻¹ k(N, z),   c(z) = R⁻ᵀ l(z),   G = wᵀ w,   w = L⁻¹ k(X, N)
    /// ```
    /// `q` is the posterior variance of the first term, and `ρ = k(z, z) - |l(z)|²`. The excess `2 √(q ρ) + ρ` is at most
    /// `TOLERANCE · (q + floor)` for every `q` if `ρ (1 + 1 / TOLERANCE) <= TOLERANCE · floor`. Nodes are added where `ρ`
    /// relative to the floor is largest until this holds at all stages. All of them are then multiplied by the inverse
    /// factor in one pass over it, which is by far the longest part. With all stages as nodes the result is exact.
    ///
    /// `q` is a difference, so that rounding may make it, and with it the bound, too small by about the machine precision times
    /// the outputscale.
    pub(crate) fn variance_bounds(
        &self,
        floor: &[GpOutput],
        scratch: &mut HorizonScratch,
        out: &mut [GpOutput],
    ) {
        scratch.queries.assign(&scratch.z);
        for (outputs, covariance) in self.by_covariance() {
            scratch.start(covariance, self.points.blocks().len());
            let floor = |t: usize| {
                floor[t].as_slice()[outputs.clone()]
                    .iter()
                    .copied()
                    .fold(f64::INFINITY, f64::min)
            };
            while let Some(node) = scratch.next_node(covariance.outputscale, floor) {
                self.add_node(covariance, node, scratch);
            }
            scratch.add_data(covariance);
            for (t, out) in out.iter_mut().enumerate() {
                let bound = scratch.variance[t] + scratch.excess(t);
                out.as_mut_slice()[outputs.clone()].fill(bound.min(covariance.outputscale));
            }
        }
    }

    /// Conditions the prior at the stages on a node and computes the node's covariances with the training points.
    fn add_node(&self, covariance: &Covariance, node: usize, scratch: &mut HorizonScratch) {
        let blocks = self.points.blocks().len();
        let query = covariance.metric.query(&scratch.z[node]);
        wide(self.kernel.with(CovarianceRow {
            outputscale: covariance.outputscale,
            points: &scratch.queries,
            norms: &scratch.norms,
            query: &query,
            row: &mut scratch.row,
        }));
        wide(self.kernel.with(CovarianceRow {
            outputscale: covariance.outputscale,
            points: &self.points,
            norms: covariance.metric.norms(),
            query: &query,
            row: &mut scratch.covariances[scratch.nodes.len() * blocks..][..blocks],
        }));
        scratch.condition(node);
    }
}

impl HorizonScratch {
    /// Sets the prior at the stages, without nodes.
    fn start(&mut self, covariance: &Covariance, blocks: usize) {
        let stages = self.z.len();
        covariance.metric.norms_of(&self.z, &mut self.norms);
        self.row.resize(self.norms.len(), [0.0; LANES]);
        for columns in [&mut self.covariances, &mut self.whitened] {
            columns.resize(stages * blocks, [0.0; LANES]);
        }
        for square in [&mut self.factor, &mut self.gram, &mut self.coefficients] {
            square.resize(stages * stages, 0.0);
        }
        self.explained.resize(stages, 0.0);
        for (values, start) in [
            (&mut self.residual, covariance.outputscale),
            (&mut self.variance, 0.0),
        ] {
            values.clear();
            values.resize(stages, start);
        }
        self.nodes.clear();
        self.nodes.reserve(stages); // a later horizon may need more nodes than the first
    }

    /// Excess of the bound over `q` at a stage.
    fn excess(&self, t: usize) -> f64 {
        2.0 * (self.variance[t] * self.residual[t]).sqrt() + self.residual[t]
    }

    /// The stage that exceeds the tolerance most if one does.
    fn next_node(&self, outputscale: f64, floor: impl Fn(usize) -> f64) -> Option<usize> {
        let score = |t: usize| self.residual[t] / floor(t);
        let exceeds = |t: &usize| score(*t) * (1.0 + 1.0 / TOLERANCE) > TOLERANCE;
        (0..self.z.len())
            .filter(|&t| self.residual[t] > SMALLEST_PIVOT * outputscale)
            .filter(exceeds)
            .max_by(|&a, &b| score(a).total_cmp(&score(b)))
    }

    /// Adds the row of `l` of a new node and updates `ρ`.
    fn condition(&mut self, node: usize) {
        let stages = self.z.len();
        let (earlier, new) = self.factor.split_at_mut(self.nodes.len() * stages);
        let row = &mut new[..stages];
        row.copy_from_slice(&self.row.as_flattened()[..stages]);
        for earlier in earlier.chunks_exact(stages) {
            add_scaled(row, -earlier[node], earlier);
        }
        let pivot = self.residual[node].sqrt();
        for (entry, residual) in row.iter_mut().zip(&mut self.residual) {
            *entry /= pivot;
            *residual = (*residual - *entry * *entry).max(0.0);
        }
        row[node] = pivot;
        self.residual[node] = 0.0;
        self.nodes.push(node);
    }

    /// Conditions the nodes on the training data: columns of `w`, rows of `G`, and `q` at all stages.
    fn add_data(&mut self, covariance: &Covariance) {
        let (stages, nodes) = (self.z.len(), self.nodes.len());
        let blocks = self.covariances.len() / stages;
        let all = nodes * blocks;
        covariance
            .inverse
            .products(&self.covariances[..all], &mut self.whitened[..all]);
        for j in 0..nodes {
            let (row, column) = (j * stages, &self.whitened[j * blocks..][..blocks]);
            let known = &self.whitened[..(j + 1) * blocks];
            dots(column, known, &mut self.gram[row..=row + j]);
            for i in 0..j {
                self.gram[i * stages + j] = self.gram[row + i];
            }
        }
        vectorised_loops(Propagate(self));
    }
}

/// Computes `c` and `q` at all stages from `R`, `l` and `G`.
struct Propagate<'a>(&'a mut HorizonScratch);

impl Vectorised for Propagate<'_> {
    type Output = ();

    #[inline(always)]
    fn compute(self) {
        let HorizonScratch {
            z,
            nodes,
            factor,
            variance,
            gram,
            coefficients,
            explained,
            ..
        } = self.0;
        let (stages, n) = (z.len(), nodes.len());
        variance.fill(0.0);
        for (l, c) in (factor.chunks_exact(stages))
            .zip(coefficients.chunks_exact_mut(stages))
            .take(n)
        {
            for (variance, l) in variance.iter_mut().zip(l) {
                *variance = l.mul_add(*l, *variance);
            }
            c.copy_from_slice(l);
        }
        // Row i of R is l_0 to l_i at node i, so that R⁻ᵀ is applied from the last row on.
        for (i, &node) in nodes.iter().enumerate().rev() {
            let (earlier, later) = coefficients.split_at_mut(i * stages);
            let c = &mut later[..stages];
            let inverse = 1.0 / factor[i * stages + node];
            for c in c.iter_mut() {
                *c *= inverse;
            }
            for (j, earlier) in earlier.chunks_exact_mut(stages).enumerate() {
                axpy(earlier, -factor[j * stages + node], c);
            }
        }
        let rows = || coefficients.chunks_exact(stages).take(n);
        for (i, c) in rows().enumerate() {
            explained.fill(0.0);
            for (g, c) in gram[i * stages..].iter().zip(rows()) {
                axpy(explained, *g, c);
            }
            for ((variance, c), explained) in variance.iter_mut().zip(c).zip(&*explained) {
                *variance -= c * explained;
            }
        }
        for q in variance.iter_mut() {
            *q = q.max(0.0);
        }
    }
}
