//! Interpolating cubic splines in the plane, twice continuously differentiable.

/// A point of a curve with its first and second derivative.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Jet {
    pub position: [f64; 2],
    pub first: [f64; 2],
    pub second: [f64; 2],
}

impl Jet {
    /// Length of the first derivative.
    pub fn speed(&self) -> f64 {
        self.first[0].hypot(self.first[1])
    }
}

/// Both coordinates as cubics in the distance `u` from the piece's first knot, constant term first.
#[derive(Debug, Clone)]
pub(crate) struct Piece([[f64; 4]; 2]);

impl Piece {
    pub fn jet(&self, u: f64) -> Jet {
        let each = |value: fn(&[f64; 4], f64) -> f64| self.0.each_ref().map(|axis| value(axis, u));
        Jet {
            position: each(|[a, b, c, d], u| a + u * (b + u * (c + u * d))),
            first: each(|[_, b, c, d], u| b + u * (2.0 * c + u * 3.0 * d)),
            second: each(|[_, _, c, d], u| 2.0 * c + u * 6.0 * d),
        }
    }

    /// The piece with these coefficients.
    pub fn new(coefficients: [[f64; 4]; 2]) -> Self {
        Self(coefficients)
    }

    /// The coefficients of both coordinates.
    pub fn coefficients(&self) -> [[f64; 4]; 2] {
        self.0
    }

    /// The point at `u = 0`.
    pub fn start(&self) -> [f64; 2] {
        [self.0[0][0], self.0[1][0]]
    }
}

/// The spline through `points`, one piece between neighbouring `knots`.
///
/// A closed spline has one more knot than points and is periodic. The third derivative of an open spline is continuous
/// at its second and last but one knot ("not-a-knot" condition), which reproduces cubics. Requires at least four points
/// and increasing knots.
pub(crate) fn interpolate(knots: &[f64], points: &[[f64; 2]], closed: bool) -> Vec<Piece> {
    let n = points.len();
    let steps: Vec<f64> = knots.windows(2).map(|k| k[1] - k[0]).collect();
    let slopes: Vec<[f64; 2]> = (steps.iter().enumerate())
        .map(|(i, h)| combine(points[(i + 1) % n], 1.0 / h, points[i], -1.0 / h))
        .collect();
    let moments = if closed {
        periodic_moments(&steps, &slopes)
    } else {
        open_moments(&steps, &slopes)
    };
    (steps.iter().enumerate())
        .map(|(i, h)| {
            let (m, next) = (moments[i], moments[(i + 1) % n]);
            Piece([0, 1].map(|axis| {
                [
                    points[i][axis],
                    slopes[i][axis] - h * (2.0 * m[axis] + next[axis]) / 6.0,
                    m[axis] / 2.0,
                    (next[axis] - m[axis]) / (6.0 * h),
                ]
            }))
        })
        .collect()
}

/// `a x + b y`.
fn combine(x: [f64; 2], a: f64, y: [f64; 2], b: f64) -> [f64; 2] {
    [a * x[0] + b * y[0], a * x[1] + b * y[1]]
}

/// Second derivatives at the knots of an open spline. Continuity of the first derivative gives
/// `h[i-1] m[i-1] + 2 (h[i-1] + h[i]) m[i] + h[i] m[i+1] = 6 (slope[i] - slope[i-1])`; the end
/// conditions eliminate the first and the last unknown.
fn open_moments(steps: &[f64], slopes: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let n = steps.len();
    let mut diagonal: Vec<f64> = (1..n).map(|i| 2.0 * (steps[i - 1] + steps[i])).collect();
    let mut lower = steps[..n - 1].to_vec();
    let mut upper = steps[1..].to_vec();
    let mut inner: Vec<_> = (1..n)
        .map(|i| combine(slopes[i], 6.0, slopes[i - 1], -6.0))
        .collect();
    let (first, last) = (steps[0] / steps[1], steps[n - 1] / steps[n - 2]);
    diagonal[0] += steps[0] * (1.0 + first);
    upper[0] -= steps[0] * first;
    diagonal[n - 2] += steps[n - 1] * (1.0 + last);
    lower[n - 2] -= steps[n - 1] * last;
    solve_tridiagonal(&lower, &diagonal, &upper, &mut inner);

    let start = combine(inner[0], 1.0 + first, inner[1], -first);
    let end = combine(inner[n - 2], 1.0 + last, inner[n - 3], -last);
    [vec![start], inner, vec![end]].concat()
}

/// Second derivatives at the knots of a periodic spline: the cyclic system is solved as a tridiagonal system with a
/// rank-one correction (Sherman-Morrison formula).
fn periodic_moments(steps: &[f64], slopes: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let n = steps.len();
    let before = |i: usize| (i + n - 1) % n;
    let mut diagonal: Vec<f64> = (0..n)
        .map(|i| 2.0 * (steps[before(i)] + steps[i]))
        .collect();
    let lower: Vec<f64> = (0..n).map(|i| steps[before(i)]).collect();
    let mut moments: Vec<_> = (0..n)
        .map(|i| combine(slopes[i], 6.0, slopes[before(i)], -6.0))
        .collect();

    let corner = steps[n - 1];
    let gamma = -diagonal[0];
    diagonal[0] -= gamma;
    diagonal[n - 1] -= corner * corner / gamma;
    let mut correction = vec![[0.0; 2]; n];
    correction[0] = [gamma; 2];
    correction[n - 1] = [corner; 2];
    solve_tridiagonal(&lower, &diagonal, steps, &mut moments);
    solve_tridiagonal(&lower, &diagonal, steps, &mut correction);

    let along = |x: &[[f64; 2]]| combine(x[0], 1.0, x[n - 1], corner / gamma);
    let (of_moments, of_correction) = (along(&moments), along(&correction));
    for (m, z) in moments.iter_mut().zip(correction) {
        for axis in 0..2 {
            m[axis] -= z[axis] * of_moments[axis] / (1.0 + of_correction[axis]);
        }
    }
    moments
}

/// Solves a diagonally dominant tridiagonal system for two right-hand sides in place.
/// `lower[0]` and the last entry of `upper` are outside the matrix and are not read.
fn solve_tridiagonal(lower: &[f64], diagonal: &[f64], upper: &[f64], rhs: &mut [[f64; 2]]) {
    let n = diagonal.len();
    let mut pivots = diagonal.to_vec();
    for i in 1..n {
        let factor = lower[i] / pivots[i - 1];
        pivots[i] -= factor * upper[i - 1];
        rhs[i] = combine(rhs[i], 1.0, rhs[i - 1], -factor);
    }
    rhs[n - 1] = combine(rhs[n - 1], 1.0 / pivots[n - 1], [0.0; 2], 0.0);
    for i in (0..n - 1).rev() {
        rhs[i] = combine(rhs[i], 1.0 / pivots[i], rhs[i + 1], -upper[i] / pivots[i]);
    }
}
