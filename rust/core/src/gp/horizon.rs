//! Bounds of the variance at all stages of a horizon from a few of them.

use super::mean::CovarianceRow;
use super::{Covariance, Gp};
use crate::cholesky::{add_scaled, dot};
use crate::kernel::{LANES, Lanes, Points};
use crate::simd::wide;
use crate::{GpInput, GpOutput};

/// Largest excess of a bound over the exact variance, relative to variance plus floor (see [`Gp::variance_bounds`]). A
/// standard deviation is then at most 5 % too large.
pub(crate) const TOLERANCE: f64 = 0.1;
/// Number of nodes that share a pass over the inverse factor; with fewer the speed of the memory is the limit.
const NODES_PER_PASS: usize = 4;
/// Smallest residual prior variance of a new node as a multiple of the outputscale; below it are rounding errors only.
const SMALLEST_PIVOT: f64 = 1e-12;

/// Memory of [`Gp::variance_bounds`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Horizon {
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
    /// `k(X, z)` of the nodes of a pass.
    covariances: [Vec<Lanes>; NODES_PER_PASS],
    /// `w` of all nodes, one after the other.
    directions: Vec<Lanes>,
    /// `H`; rows are as long as the number of stages.
    gram: Vec<f64>,
    /// One component of `(I - H) l` at all stages.
    unexplained: Vec<f64>,
}

impl Gp {
    /// Upper bounds of the variances at the z-scored inputs `scratch.z`, in z-scored units, each at most `TOLERANCE ·
    /// (σ² + floor)` above the exact `σ²`, where `floor` is the variance that the caller adds to the bound. Outputs
    /// that share a covariance use the smallest of their floors.
    ///
    /// Stages lie on a curve, so the values of the latent function at a few of them, the nodes `N`, nearly determine
    /// the others. Given noise-free values `f_N`, at any stage `f(z) = k(z, N) K_NN⁻¹ f_N + e`, where `e` has the prior
    /// variance `ρ(z) = k(z, z) - k(z, N) K_NN⁻¹ k(N, z)`. Data can only lower this variance, and by Cauchy-Schwarz
    /// ```text
    /// √q - √ρ <= σ(z) <= √q + √ρ,     q = l(z)ᵀ (I - H) l(z),
    /// R Rᵀ = K_NN,   l(z) = R⁻¹ k(N, z),   w = L⁻¹ k(X, N) R⁻ᵀ,   H = wᵀ w
    /// ```
    /// `q` is the posterior variance of the first term, and `ρ = k(z, z) - |l(z)|²`. Nodes are added where `ρ` relative
    /// to the known variance is largest, four at a time, until `2 √(q ρ) + ρ` is below the tolerance at all stages.
    /// With all stages as nodes the result is exact.
    pub(crate) fn variance_bounds(
        &self,
        floor: &[GpOutput],
        scratch: &mut Horizon,
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
            while scratch.exceeds(floor) {
                let before = scratch.nodes.len();
                for slot in 0..NODES_PER_PASS {
                    match scratch.next_node(covariance.outputscale, floor) {
                        Some(node) => self.add_node(covariance, node, slot, scratch),
                        None => scratch.covariances[slot].fill([0.0; LANES]),
                    }
                }
                if scratch.nodes.len() == before {
                    break;
                }
                scratch.add_data(covariance, before);
            }
            for (t, out) in out.iter_mut().enumerate() {
                let bound = scratch.variance[t] + scratch.excess(t);
                out.as_mut_slice()[outputs.clone()].fill(bound.min(covariance.outputscale));
            }
        }
    }

    /// Conditions the prior at the stages on a node and computes the node's covariances with the training points.
    fn add_node(&self, covariance: &Covariance, node: usize, slot: usize, scratch: &mut Horizon) {
        let query = covariance.metric.query(&scratch.z[node]);
        let row = CovarianceRow {
            kernel: self.kernel,
            outputscale: covariance.outputscale,
            points: &scratch.queries,
            norms: &scratch.norms,
            query: &query,
            row: &mut scratch.row,
        };
        wide(row);
        scratch.condition(node);
        wide(CovarianceRow {
            kernel: self.kernel,
            outputscale: covariance.outputscale,
            points: &self.points,
            norms: covariance.metric.norms(),
            query: &query,
            row: &mut scratch.covariances[slot],
        });
    }
}

impl Horizon {
    /// Sets the prior at the stages, without nodes.
    fn start(&mut self, covariance: &Covariance, blocks: usize) {
        let stages = self.z.len();
        covariance.metric.norms_of(&self.z, &mut self.norms);
        self.row.resize(self.norms.len(), [0.0; LANES]);
        for covariances in &mut self.covariances {
            covariances.resize(blocks, [0.0; LANES]);
        }
        self.directions
            .resize((stages + NODES_PER_PASS) * blocks, [0.0; LANES]);
        for square in [&mut self.factor, &mut self.gram] {
            square.resize(stages * stages, 0.0);
        }
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

    fn exceeds(&self, floor: impl Fn(usize) -> f64) -> bool {
        (0..self.z.len()).any(|t| self.excess(t) > TOLERANCE * (self.variance[t] + floor(t)))
    }

    /// The stage with the largest residual prior variance relative to its known variance.
    fn next_node(&self, outputscale: f64, floor: impl Fn(usize) -> f64) -> Option<usize> {
        let score = |t: usize| self.residual[t] / (self.variance[t] + floor(t));
        (0..self.z.len())
            .filter(|&t| self.residual[t] > SMALLEST_PIVOT * outputscale)
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

    /// Conditions the nodes from `first` on the training data: columns of `w`, rows of `H`, and `q` at all stages.
    fn add_data(&mut self, covariance: &Covariance, first: usize) {
        let (stages, blocks) = (self.z.len(), self.covariances[0].len());
        let new = &mut self.directions[first * blocks..];
        let (ab, cd) = new[..NODES_PER_PASS * blocks].split_at_mut(2 * blocks);
        let ((a, b), (c, d)) = (ab.split_at_mut(blocks), cd.split_at_mut(blocks));
        let covariances = self.covariances.each_ref().map(Vec::as_slice);
        covariance.inverse.products(covariances, [a, b, c, d]);
        for j in first..self.nodes.len() {
            let (known, new) = self.directions.split_at_mut(j * blocks);
            let direction = &mut new[..blocks];
            let r = |i: usize| self.factor[i * stages + self.nodes[j]];
            for (i, known) in known.chunks_exact(blocks).enumerate() {
                add_scaled(direction.as_flattened_mut(), -r(i), known.as_flattened());
            }
            let inverse = 1.0 / r(j);
            direction
                .as_flattened_mut()
                .iter_mut()
                .for_each(|x| *x *= inverse);
            for (i, known) in known.chunks_exact(blocks).enumerate() {
                let entry = dot(known, direction);
                (self.gram[i * stages + j], self.gram[j * stages + i]) = (entry, entry);
            }
            self.gram[j * stages + j] = dot(direction, direction);
        }
        let nodes = self.nodes.len();
        let rows = || self.factor.chunks_exact(stages).take(nodes);
        self.variance.fill(0.0);
        for (i, l) in rows().enumerate() {
            self.unexplained.clear();
            self.unexplained.extend_from_slice(l);
            for (h, l) in self.gram[i * stages..].iter().zip(rows()) {
                add_scaled(&mut self.unexplained, -h, l);
            }
            for ((variance, l), unexplained) in
                self.variance.iter_mut().zip(l).zip(&self.unexplained)
            {
                *variance += l * unexplained;
            }
        }
        self.variance.iter_mut().for_each(|q| *q = q.max(0.0));
    }
}
