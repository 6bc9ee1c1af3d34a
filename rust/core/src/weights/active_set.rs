//! An exact solver for small QPs on the simplex, with or without an L1 term.
//!
//! ```text
//! min  ½ wᵀHw + gᵀw + alpha ||w - p||_1   s.t.  w >= 0,  Σ w = 1        (H symmetric positive definite)
//! ```
//!
//! A primal active-set method. Along each coordinate the cost is piecewise quadratic with kinks at 0 and, if alpha > 0,
//! at `p_i`. Fixed coordinates are at a kink, free ones strictly between two kinks. Each iteration minimises over the
//! free coordinates. It either stops at the first kink, where a coordinate becomes fixed, or reaches the minimum and
//! then frees the fixed coordinate with the steepest one-sided descent. An iteration does not raise the cost; the number of
//! iterations is limited, because steps of length zero could repeat. From the previous weights the method usually takes two
//! or three iterations.

use crate::cholesky::{add_scaled, sum_of_products};
use crate::simd::{Vectorised, vectorised_loops};

/// Position of a coordinate relative to the kinks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// At a kink.
    Fixed,
    /// Between kinks, below `p_i` if alpha > 0.
    Below,
    /// Between kinks, above `p_i`.
    Above,
}

/// A coordinate at most this far from a kink counts as fixed there at the start. After a step it is moved to the kink ahead of
/// it if it is at most this far from that kink, or beyond it.
const SNAP: f64 = 1e-14;
/// Slopes are compared with this tolerance, relative to the size of the problem's numbers.
const SLOPE_TOLERANCE: f64 = 1e-12;

/// Solver for `n` coordinates, with its memory.
#[derive(Debug, Clone)]
pub(super) struct SimplexSolver {
    place: Vec<Place>,
    free: Vec<usize>,
    gradient: Vec<f64>,
    /// Cholesky factor of H on the free coordinates, row-major lower triangle.
    factor: Vec<f64>,
    newton: Vec<f64>,
    ones: Vec<f64>,
}

/// One problem; see the module's formula.
#[derive(Debug, Clone, Copy)]
pub(super) struct SimplexQp<'a> {
    /// `H`, row-major `[n, n]`.
    pub hessian: &'a [f64],
    /// `g`.
    pub linear: &'a [f64],
    /// `p`, on the simplex.
    pub centre: &'a [f64],
    /// `alpha >= 0`.
    pub alpha: f64,
}

impl SimplexSolver {
    /// Memory for `n` coordinates.
    pub fn new(n: usize) -> Self {
        Self {
            place: vec![Place::Fixed; n],
            free: Vec::with_capacity(n),
            gradient: vec![0.0; n],
            factor: vec![0.0; n * n],
            newton: vec![0.0; n],
            ones: vec![0.0; n],
        }
    }

    /// Moves `w`, which must be on the simplex, to the minimum. Returns the number of iterations, or `None` if rounding
    /// errors prevent termination within `50 + 20 n`, or if `H` is not positive definite up to rounding or `g` is not finite;
    /// then `w` is on the simplex and its cost has not risen.
    pub fn solve(&mut self, qp: &SimplexQp, w: &mut [f64]) -> Option<usize> {
        let n = w.len();
        for ((place, &wi), &centre) in self.place.iter_mut().zip(w.iter()).zip(qp.centre) {
            let on_kink = wi <= SNAP || (qp.alpha > 0.0 && (wi - centre).abs() <= SNAP);
            *place = if on_kink {
                Place::Fixed
            } else {
                side(wi > centre)
            };
        }
        let tolerance = SLOPE_TOLERANCE * scale(qp);
        let mut outcome = None;
        for iteration in 1..=50 + 20 * n {
            self.update(qp, w);
            if self.free.len() > 1 {
                match self.minimise_free(qp, w) {
                    Some(Stop::Kink) => continue,
                    Some(Stop::Minimum) => {}
                    None => break,
                }
            }
            self.update(qp, w);
            if !self.release(qp, w, tolerance) {
                outcome = Some(iteration);
                break;
            }
        }
        let sum: f64 = w.iter().sum();
        for wi in w.iter_mut() {
            *wi /= sum;
        }
        outcome
    }

    /// Updates the list of free coordinates and the gradient `Hw + g` at `w`.
    fn update(&mut self, qp: &SimplexQp, w: &[f64]) {
        let n = w.len();
        self.free.clear();
        self.free
            .extend((0..n).filter(|&i| self.place[i] != Place::Fixed));
        // Sums the rows of `H`, which equal its columns, of the few nonzero weights.
        self.gradient.copy_from_slice(qp.linear);
        for (wi, row) in w.iter().zip(qp.hessian.chunks_exact(n)) {
            if *wi != 0.0 {
                add_scaled(&mut self.gradient, *wi, row);
            }
        }
    }

    /// One-sided derivative of the cost in `w_i`, above or below the kink `p_i`.
    fn slope(&self, qp: &SimplexQp, i: usize, above: bool) -> f64 {
        self.gradient[i] + if above { qp.alpha } else { -qp.alpha }
    }

    /// Newton step over the free coordinates subject to `Σ d = 0`, truncated at the first kink. None, without a step, if it
    /// cannot be computed.
    fn minimise_free(&mut self, qp: &SimplexQp, w: &mut [f64]) -> Option<Stop> {
        if !self.factorise(qp.hessian, w.len()) {
            return None;
        }
        let m = self.free.len();
        for (k, &i) in self.free.iter().enumerate() {
            self.newton[k] = self.slope(qp, i, self.place[i] == Place::Above);
            self.ones[k] = 1.0;
        }
        cholesky_solve(&self.factor, m, &mut self.newton);
        cholesky_solve(&self.factor, m, &mut self.ones);
        let shift = self.newton[..m].iter().sum::<f64>() / self.ones[..m].iter().sum::<f64>();
        if !shift.is_finite() {
            return None;
        }
        let kink = |place: Place, d: f64, i: usize| match place {
            Place::Above if qp.alpha > 0.0 && d < 0.0 => Some(qp.centre[i]),
            Place::Below if qp.alpha > 0.0 && d > 0.0 => Some(qp.centre[i]),
            _ if d < 0.0 => Some(0.0),
            _ => None,
        };
        let mut step = 1.0;
        for (k, &i) in self.free.iter().enumerate() {
            let d = shift * self.ones[k] - self.newton[k];
            if let Some(kink) = kink(self.place[i], d, i) {
                step = f64::min(step, (kink - w[i]) / d);
            }
        }
        let mut stop = Stop::Minimum;
        for (k, &i) in self.free.iter().enumerate() {
            let d = shift * self.ones[k] - self.newton[k];
            w[i] += step * d;
            if let Some(kink) = kink(self.place[i], d, i)
                && (w[i] - kink) * d.signum() >= -SNAP
            {
                w[i] = kink;
                self.place[i] = Place::Fixed;
                stop = Stop::Kink;
            }
        }
        Some(stop)
    }

    /// At a minimum over the free coordinates, frees the fixed coordinates with the steepest descent; false if none
    /// descends.
    fn release(&mut self, qp: &SimplexQp, w: &[f64], tolerance: f64) -> bool {
        let growing = best((0..w.len()).map(|i| -self.slope(qp, i, w[i] >= qp.centre[i])));
        let shrinking = best((0..w.len()).map(|i| {
            if w[i] > 0.0 {
                self.slope(qp, i, w[i] > qp.centre[i])
            } else {
                f64::NEG_INFINITY
            }
        }));
        let ((up, up_descent), (down, down_descent)) = (growing, shrinking);
        if up_descent + down_descent <= tolerance {
            return false;
        }
        if self.free.is_empty() {
            self.place[up] = side(w[up] >= qp.centre[up]);
            self.place[down] = side(w[down] > qp.centre[down]);
            return true;
        }
        // Only one coordinate is freed, so that the next Newton step moves it in its descent direction.
        let level = self
            .free
            .iter()
            .map(|&i| self.slope(qp, i, self.place[i] == Place::Above))
            .sum::<f64>()
            / self.free.len() as f64;
        let up_first = up_descent + level >= down_descent - level;
        for grow in [up_first, !up_first] {
            let i = if grow { up } else { down };
            if self.place[i] == Place::Fixed {
                self.place[i] = side(if grow {
                    w[i] >= qp.centre[i]
                } else {
                    w[i] > qp.centre[i]
                });
                return true;
            }
        }
        false
    }

    /// Lower Cholesky factor of H on the free coordinates; false if a pivot is at most its rounding error, or NaN.
    fn factorise(&mut self, hessian: &[f64], n: usize) -> bool {
        vectorised_loops(Factorise {
            hessian,
            n,
            free: &self.free,
            factor: &mut self.factor,
        })
    }
}

/// Computation of [`SimplexSolver::factorise`].
struct Factorise<'a> {
    hessian: &'a [f64],
    n: usize,
    free: &'a [usize],
    factor: &'a mut [f64],
}

impl Vectorised for Factorise<'_> {
    type Output = bool;

    #[inline(always)]
    fn compute(self) -> bool {
        let m = self.free.len();
        for row in 0..m {
            for column in 0..=row {
                let (above, below) = self.factor.split_at_mut(row * m);
                let upper = if column == row {
                    &below[..column]
                } else {
                    &above[column * m..column * m + column]
                };
                let dot = sum_of_products(&below[..column], upper);
                let entry = self.hessian[self.free[row] * self.n + self.free[column]];
                let value = entry - dot;
                below[column] = if column == row {
                    if value.is_nan() || value <= self.n as f64 * f64::EPSILON * entry {
                        return false;
                    }
                    value.sqrt()
                } else {
                    value / above[column * m + column]
                };
            }
        }
        true
    }
}

/// Where a step over the free coordinates ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stop {
    Kink,
    Minimum,
}

fn side(above: bool) -> Place {
    if above { Place::Above } else { Place::Below }
}

/// Scale of the gradient's terms.
fn scale(qp: &SimplexQp) -> f64 {
    let largest = |m: f64, v: &f64| m.max(v.abs());
    let diagonal = qp.hessian.iter().step_by(qp.linear.len() + 1); // contains the largest entry of a definite matrix
    diagonal.fold(0.0, largest) + qp.linear.iter().fold(0.0, largest) + qp.alpha
}

/// Index and value of the first largest number.
fn best(values: impl Iterator<Item = f64>) -> (usize, f64) {
    values.enumerate().fold(
        (0, f64::NEG_INFINITY),
        |m, (i, v)| if v > m.1 { (i, v) } else { m },
    )
}

/// Solves `L Lᵀ x = b` in place for a row-major lower factor of order `m`.
fn cholesky_solve(factor: &[f64], m: usize, b: &mut [f64]) {
    for i in 0..m {
        let dot: f64 = factor[i * m..i * m + i]
            .iter()
            .zip(b.iter())
            .map(|(l, x)| l * x)
            .sum();
        b[i] = (b[i] - dot) / factor[i * m + i];
    }
    for i in (0..m).rev() {
        let dot: f64 = (i + 1..m).map(|k| factor[k * m + i] * b[k]).sum();
        b[i] = (b[i] - dot) / factor[i * m + i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_stay_on_the_simplex_if_the_hessian_has_lost_a_pivot_or_a_number_is_nan() {
        let (nan, start) = (f64::NAN, [0.5, 0.5]);
        for (hessian, linear) in [
            ([1.0, 1.0, 1.0, 1.0], [0.1, -0.1]),
            ([nan, 0.0, 0.0, 1.0], [0.1, -0.1]),
            ([1.0, 0.0, 0.0, 1.0], [nan, -0.1]),
        ] {
            let qp = SimplexQp {
                hessian: &hessian,
                linear: &linear,
                centre: &start,
                alpha: 0.0,
            };
            let mut w = start;
            assert_eq!(SimplexSolver::new(2).solve(&qp, &mut w), None);
            assert_eq!(w, start);
        }
    }
}
