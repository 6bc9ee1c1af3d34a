//! Agreement of the weights with Clarabel on thousands of random problems, some of them degenerate.
#![allow(clippy::unwrap_used)]

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus, ZeroConeT,
};
use egp_core::settings::Prior;
use egp_core::weights::{WeightEstimator, WindowNoise};
use egp_core::{GpOutput, NY};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// One instance of eq. (6).
struct Problem {
    f: Vec<f64>,
    y: Vec<[f64; NY]>,
    /// Standard deviations of model and measured states.
    noise: [GpOutput; 2],
    prior: Prior,
    previous: Vec<f64>,
}

impl Problem {
    fn random(rng: &mut ChaCha8Rng) -> Self {
        let n = [1, 2, 2, 3, 5, 8, 20, 64][rng.random_range(0..8)];
        let k = [0, 1, 2, 10, 40][rng.random_range(0..5)];
        let mut f: Vec<f64> = (0..k * n * NY)
            .map(|_| rng.random_range(-0.5..0.5))
            .collect();
        match rng.random_range(0..6) {
            0 => (0..f.len()).for_each(|i| f[i] = f[i / (n * NY) * (n * NY) + i % NY]), // identical members
            1 => f.iter_mut().step_by(2).for_each(|v| *v = 0.0),
            2 => f.fill(0.0),
            _ => {}
        }
        let truth = simplex(rng, n);
        let noise = rng.random_range(0.0..0.05);
        let y = f.chunks(n * NY).map(|row| {
            std::array::from_fn(|o| {
                let blend: f64 = (0..n).map(|i| truth[i] * row[i * NY + o]).sum();
                blend + noise * rng.random_range(-1.0..1.0)
            })
        });
        let y = y.collect();
        let strength = [0.0, 1e-5, 0.01, 1.0, 20.0, 1e4][rng.random_range(0..6)];
        let prior = if rng.random_range(0..2) == 0 {
            Prior::Quadratic { lambda: strength }
        } else {
            Prior::L1 { alpha: strength }
        };
        let mut std = || GpOutput::from_fn(|_, _| 10.0_f64.powf(rng.random_range(-3.0..0.0)));
        let (model, state) = (std(), std());
        let noise = match rng.random_range(0..3) {
            0 => [GpOutput::repeat(1.0), GpOutput::zeros()],
            1 => [model, GpOutput::zeros()],
            _ => [model, state],
        };
        Self {
            f,
            y,
            noise,
            prior,
            previous: simplex(rng, n),
        }
    }

    /// The weights; panics unless the solver terminated and the weights are on the simplex.
    fn solve(&self) -> Vec<f64> {
        let n = self.previous.len();
        let mut w = vec![0.0; n];
        let mut estimator = WeightEstimator::new(n, self.y.len());
        let rounds = estimator.estimate(
            &self.f,
            &self.y,
            &WindowNoise::new(&self.noise[0], &self.noise[1], self.y.len()),
            self.prior,
            &self.previous,
            &mut w,
        );
        assert!(
            rounds.is_some(),
            "did not terminate: N {n}, {:?}",
            self.prior
        );
        assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-12 && w.iter().all(|w| *w >= 0.0));
        w
    }

    /// `F` and `Y`, whitened with the dense covariance of their rows.
    fn scaled(&self) -> (DMatrix<f64>, DVector<f64>) {
        let (n, rows) = (self.previous.len(), self.y.len() * NY);
        let f = DMatrix::from_fn(rows, n, |r, i| self.f[(r / NY) * n * NY + i * NY + r % NY]);
        let y = DVector::from_fn(rows, |r, _| self.y[r / NY][r % NY]);
        let [model, state] = &self.noise;
        let covariance = DMatrix::from_fn(rows, rows, |i, j| match i.abs_diff(j) {
            0 => model[i % NY].powi(2) + 2.0 * state[i % NY].powi(2),
            NY => -state[i % NY].powi(2), // the same output of an adjacent transition
            _ => 0.0,
        });
        let whitening = covariance.cholesky().unwrap().l();
        (
            whitening.solve_lower_triangular(&f).unwrap(),
            whitening.solve_lower_triangular(&y).unwrap(),
        )
    }

    fn objective(&self, w: &[f64]) -> f64 {
        let (f, y) = self.scaled();
        let w = DVector::from_column_slice(w);
        let moved = &w - DVector::from_column_slice(&self.previous);
        (y - f * &w).norm_squared()
            + match self.prior {
                Prior::Quadratic { lambda } => lambda * moved.norm_squared(),
                Prior::L1 { alpha } => alpha * moved.lp_norm(1),
            }
    }

    /// The weights computed by Clarabel, with the L1 term in the form `|w - p| <= t`.
    fn clarabel(&self) -> Option<Vec<f64>> {
        let n = self.previous.len();
        let (f, y) = self.scaled();
        let (lambda, alpha) = match self.prior {
            Prior::Quadratic { lambda } => (lambda, 0.0),
            Prior::L1 { alpha } => (0.0, alpha),
        };
        let p = DVector::from_column_slice(&self.previous);
        let mut hessian = DMatrix::zeros(2 * n, 2 * n);
        hessian
            .view_mut((0, 0), (n, n))
            .copy_from(&(2.0 * (f.transpose() * &f + lambda * DMatrix::identity(n, n))));
        let mut q = vec![alpha; 2 * n];
        q[..n].copy_from_slice((-2.0 * (f.transpose() * y + lambda * &p)).as_slice());
        let mut a = DMatrix::zeros(1 + 3 * n, 2 * n);
        let mut b = vec![0.0; 1 + 3 * n];
        b[0] = 1.0;
        for i in 0..n {
            a[(0, i)] = 1.0;
            a[(1 + i, i)] = -1.0;
            (a[(1 + n + i, i)], a[(1 + n + i, n + i)], b[1 + n + i]) = (1.0, -1.0, p[i]);
            (
                a[(1 + 2 * n + i, i)],
                a[(1 + 2 * n + i, n + i)],
                b[1 + 2 * n + i],
            ) = (-1.0, -1.0, -p[i]);
        }
        let settings = DefaultSettings {
            verbose: false,
            tol_gap_abs: 1e-11,
            tol_gap_rel: 1e-11,
            ..DefaultSettings::default()
        };
        let cones = [ZeroConeT(1), NonnegativeConeT(3 * n)];
        let mut solver = DefaultSolver::new(
            &sparse(&hessian).to_triu(),
            &q,
            &sparse(&a),
            &b,
            &cones,
            settings,
        )
        .unwrap();
        solver.solve();
        (solver.solution.status == SolverStatus::Solved).then(|| solver.solution.x[..n].to_vec())
    }
}

fn simplex(rng: &mut ChaCha8Rng, n: usize) -> Vec<f64> {
    let corner = rng.random_range(0..3) == 0;
    let mut w: Vec<f64> = (0..n)
        .map(|_| {
            if corner && rng.random_range(0..2) == 0 {
                0.0
            } else {
                rng.random_range(0.0..1.0)
            }
        })
        .collect();
    w[0] += 1e-3;
    let sum: f64 = w.iter().sum();
    w.iter().map(|w| w / sum).collect()
}

fn sparse(m: &DMatrix<f64>) -> CscMatrix<f64> {
    let rows: Vec<Vec<f64>> = m
        .row_iter()
        .map(|row| row.iter().copied().collect())
        .collect();
    CscMatrix::from(&rows)
}

#[test]
fn clarabel_finds_no_better_weights() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut compared = 0;
    for case in 0..3000 {
        let problem = Problem::random(&mut rng);
        let w = problem.solve();
        let Some(other) = problem.clarabel() else {
            continue;
        };
        compared += 1;
        let (ours, theirs) = (problem.objective(&w), problem.objective(&other));
        // At the minimum of a cost with curvature 2 lambda, any other point costs lambda |distance|² more.
        let lambda = match problem.prior {
            Prior::Quadratic { lambda } => lambda,
            Prior::L1 { .. } => 0.0,
        };
        let distance = (DVector::from_vec(w) - DVector::from_vec(other)).norm_squared();
        assert!(
            ours + lambda * distance <= theirs + 1e-7 * theirs.max(1.0),
            "{case}: {ours} {theirs} {distance}"
        );
    }
    assert!(compared > 2900, "Clarabel solved only {compared}");
}

#[test]
fn identical_members_keep_their_weights() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for _ in 0..500 {
        let mut problem = Problem::random(&mut rng);
        let n = problem.previous.len();
        for i in 0..problem.f.len() {
            problem.f[i] = problem.f[i / (n * NY) * (n * NY) + i % NY];
        }
        let w = problem.solve();
        for (w, previous) in w.iter().zip(&problem.previous) {
            assert!(
                (w - previous).abs() < 1e-4, // rounding error divided by the ridge, without a prior
                "{w} {previous} {:?}",
                problem.prior
            );
        }
    }
}

#[test]
fn the_l1_prior_changes_nothing_for_small_errors() {
    let problem = Problem {
        f: vec![0.10, 0.0, 0.0, 0.12, 0.0, 0.0],
        y: vec![[0.115, 0.0, 0.0]],
        noise: [GpOutput::repeat(1.0), GpOutput::zeros()],
        prior: Prior::L1 { alpha: 1e-3 },
        previous: vec![0.5, 0.5],
    };
    assert_eq!(problem.solve(), problem.previous);
    let free = Problem {
        prior: Prior::L1 { alpha: 0.0 },
        ..problem
    };
    assert!((free.solve()[1] - 0.75).abs() < 1e-6);
}
