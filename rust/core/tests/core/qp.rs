//! The optimal control problem, its check and its sparse form, on random problems.
#![allow(clippy::unwrap_used)]

use egp_core::qp::{
    A_PATTERN, B_PATTERN, KktResidual, MAX_SOFT, OcpQp, Penalty, Q_PATTERN, SOFT_PATTERN, SparseQp,
};
use egp_core::settings::SolverSettings;
use egp_core::solver::{ClarabelSolver, solve_checked};
use egp_core::{Input, NU, NX, OcpSolution, QpSolver, State, Status};
use nalgebra::DVector;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Vehicle-like dynamics with all entries of the pattern, errors of a few metres, bounds of which many are active.
fn random(rng: &mut ChaCha8Rng, horizon: usize, n_soft: usize) -> OcpQp {
    let mut qp = OcpQp::new(horizon, n_soft);
    let mut r = |scale: f64| scale * rng.random_range(-1.0..1.0);
    qp.x0 = State::from_fn(|_, _| r(1.0));
    qp.u_prev = Input::new(r(2.0), r(0.3));
    (qp.r, qp.r_d) = (Input::new(0.05, 2.0), Input::new(0.05, 5.0));
    qp.penalty = [Penalty {
        linear: 10.0 + r(5.0),
        quadratic: 100.0,
    }; MAX_SOFT];
    for stage in qp.stages_mut() {
        for i in 0..NX {
            stage.a[(i, i)] = 0.95;
            A_PATTERN[i]
                .iter()
                .for_each(|&j| stage.a[(i, j)] += r(0.08));
            B_PATTERN[i].iter().for_each(|&j| stage.b[(i, j)] = r(0.1));
        }
        stage.c = State::from_fn(|_, _| r(0.1));
        stage.q.fill(0.0);
        for (i, j) in Q_PATTERN {
            let value = if i == j { 5.0 + r(4.0) } else { r(1.0) };
            (stage.q[(i, j)], stage.q[(j, i)]) = (value, value);
        }
        stage.reference = State::from_fn(|_, _| r(3.0));
        (stage.u_min, stage.u_max) = (Input::new(-4.0, -0.4), Input::new(3.0, 0.4));
        (stage.du_min, stage.du_max) = (Input::new(-1.5, -0.2), Input::new(1.5, 0.2));
        for (row, states) in stage.soft.iter_mut().zip(SOFT_PATTERN) {
            row.normal.fill(0.0);
            for &i in states {
                row.normal[i] = r(1.0);
            }
            (row.lower, row.upper) = (-0.5 + r(0.4), 0.5 + r(0.4));
        }
    }
    qp
}

fn solve(qp: &OcpQp) -> OcpSolution {
    let settings = SolverSettings::default();
    let mut solution = OcpSolution::new(qp.horizon());
    let mut solver = ClarabelSolver::new(qp, &settings).unwrap();
    solve_checked(&mut solver, qp, &[], settings.kkt_tolerance, &mut solution);
    solution
}

/// The cost by the module's formula, with optimal slacks.
fn cost(qp: &OcpQp, u: &[Input]) -> f64 {
    let mut x = vec![State::zeros(); qp.horizon() + 1];
    qp.roll_out(u, &mut x);
    let mut before = qp.u_prev;
    let mut sum = 0.0;
    for (t, stage) in qp.stages().iter().enumerate() {
        let (error, du) = (x[t + 1] - stage.reference, u[t] - before);
        sum += 0.5
            * (error.dot(&(stage.q * error))
                + u[t].dot(&u[t].component_mul(&qp.r))
                + du.dot(&du.component_mul(&qp.r_d)));
        for (row, penalty) in stage.soft.iter().zip(&qp.penalty).take(qp.n_soft()) {
            let value = row.normal.dot(&x[t + 1]);
            let slack = (row.lower - value).max(value - row.upper).max(0.0);
            sum += penalty.linear * slack + 0.5 * penalty.quadratic * slack * slack;
        }
        before = u[t];
    }
    sum
}

#[test]
fn random_problems_are_solved_and_no_neighbour_is_better() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut active, mut soft) = (0, 0);
    for case in 0..60 {
        let qp = random(&mut rng, 5 + case % 20, if case % 2 == 0 { 3 } else { 5 });
        assert!(qp.is_well_posed() && qp.keeps_pattern());
        let solution = solve(&qp);
        assert_eq!(
            solution.status,
            Status::Solved,
            "{case}: {:?}",
            solution.kkt
        );
        active += solution
            .multipliers
            .iter()
            .filter(|m| m.u_upper.max() > 1e-3 || m.du_upper.max() > 1e-3)
            .count();
        soft += solution
            .multipliers
            .iter()
            .filter(|m| m.soft_upper.iter().any(|y| *y > 1e-3))
            .count();
        let best = cost(&qp, &solution.u);
        // Convexity: the cost at feasible mixtures with another feasible sequence must not fall.
        for _ in 0..20 {
            let mut before = qp.u_prev;
            let other = qp.stages().iter().map(|stage| {
                let low = stage.u_min.sup(&(before + stage.du_min));
                let high = stage.u_max.inf(&(before + stage.du_max));
                before = low + (high - low) * rng.random_range(0.0..1.0);
                before
            });
            let mixed: Vec<Input> = other
                .zip(&solution.u)
                .map(|(other, u)| u + 1e-3 * (other - u))
                .collect();
            assert!(cost(&qp, &mixed) >= best - 1e-7 * best, "{case}");
        }
    }
    assert!(
        active > 100 && soft > 100,
        "the problems must be hard: {active} {soft}"
    );
}

#[test]
fn the_kkt_residual_shows_each_error() {
    let qp = random(&mut ChaCha8Rng::seed_from_u64(2), 15, 5);
    let good = solve(&qp);
    let residual = |change: fn(&mut OcpSolution)| {
        let mut bad = good.clone();
        change(&mut bad);
        qp.check(&mut bad);
        bad.kkt
    };
    let tolerance = 1e-5;
    assert!(residual(|_| ()).worst() < tolerance);
    assert!(residual(|s| s.u[3][0] += 0.01).stationarity > tolerance);
    assert!(residual(|s| s.u[3][1] += 1.0).primal > 0.1);
    assert!(residual(|s| s.multipliers[0].u_lower[0] = -1.0).dual > tolerance);
    assert!(residual(|s| s.multipliers[2].soft_upper[1] += 1.0).worst() > tolerance);
    assert!(
        residual(|s| s.multipliers.iter_mut().for_each(
            |m| (m.du_lower[0], m.du_upper[0]) = (m.du_lower[0] + 9.0, m.du_upper[0] + 9.0)
        ))
        .complementarity
            > tolerance
    );
    assert!(residual(|s| s.u[0][0] = f64::NAN).worst().is_infinite());
    assert!(KktResidual::default().worst().is_infinite());
}

/// A solver that reports success for a wrong solution.
struct WrongSolver;

impl QpSolver for WrongSolver {
    fn solve(&mut self, _: &OcpQp, _: &[Input], out: &mut OcpSolution) -> Status {
        out.u.fill(Input::zeros());
        Status::Solved
    }
    fn name(&self) -> &'static str {
        "liar"
    }
}

#[test]
fn a_wrong_solution_is_not_called_solved() {
    let mut qp = random(&mut ChaCha8Rng::seed_from_u64(3), 10, 3);
    let mut solution = OcpSolution::new(10);
    assert_eq!(
        solve_checked(&mut WrongSolver, &qp, &[], 1e-5, &mut solution),
        Status::CheckFailed
    );
    qp.stages_mut()[4].c[2] = f64::NAN;
    assert_eq!(
        solve_checked(&mut WrongSolver, &qp, &[], 1e-5, &mut solution),
        Status::NumericalError
    );
    let settings = SolverSettings {
        max_iterations: 2,
        ..SolverSettings::default()
    };
    let qp = random(&mut ChaCha8Rng::seed_from_u64(3), 10, 3);
    let mut solver = ClarabelSolver::new(&qp, &settings).unwrap();
    assert_eq!(
        solve_checked(&mut solver, &qp, &[], 1e-5, &mut solution),
        Status::IterationLimit
    );
}

#[test]
fn impossible_hard_bounds_are_infeasible() {
    let mut qp = random(&mut ChaCha8Rng::seed_from_u64(4), 10, 3);
    qp.stages_mut()[0].u_min = Input::new(100.0, 0.0);
    qp.stages_mut()[0].u_max = Input::new(101.0, 0.1);
    assert_eq!(solve(&qp).status, Status::Infeasible);
}

#[test]
fn updating_in_place_gives_the_bits_of_a_fresh_solver() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let problems: Vec<OcpQp> = (0..10).map(|_| random(&mut rng, 12, 5)).collect();
    let settings = SolverSettings::default();
    let mut used = ClarabelSolver::new(&problems[0], &settings).unwrap();
    let mut solution = OcpSolution::new(12);
    for qp in problems.iter().chain(&problems) {
        solve_checked(&mut used, qp, &[], settings.kkt_tolerance, &mut solution);
        let mut fresh = ClarabelSolver::new(&OcpQp::new(12, 5), &settings).unwrap();
        let mut other = OcpSolution::new(12);
        solve_checked(&mut fresh, qp, &[], settings.kkt_tolerance, &mut other);
        assert_eq!(solution, other);
    }
}

#[test]
fn the_sparse_form_is_the_same_problem() {
    let qp = random(&mut ChaCha8Rng::seed_from_u64(6), 8, 5);
    let solution = solve(&qp);
    let sparse = SparseQp::new(&qp);
    // z = [u_t, x_{t+1} - r_{t+1}, s_{t+1}] for each stage.
    let mut z = Vec::new();
    for (t, stage) in qp.stages().iter().enumerate() {
        z.extend_from_slice(solution.u[t].as_slice());
        z.extend_from_slice((solution.x[t + 1] - stage.reference).as_slice());
        z.extend(stage.soft.iter().map(|row| {
            let value = row.normal.dot(&solution.x[t + 1]);
            (row.lower - value).max(value - row.upper).max(0.0)
        }));
    }
    let z = DVector::from_vec(z);
    let product = |m: &egp_core::qp::Csc, symmetric: bool| {
        let mut out = DVector::zeros(m.rows);
        for column in 0..m.columns {
            for k in m.column_start[column]..m.column_start[column + 1] {
                let row = m.row_index[k];
                out[row] += m.values[k] * z[column];
                if symmetric && row != column {
                    out[column] += m.values[k] * z[row];
                }
            }
        }
        out
    };
    let rows = product(&sparse.a, false);
    for (row, (l, u)) in rows.iter().zip(sparse.l.iter().zip(&sparse.u)) {
        assert!((l - 1e-7..=u + 1e-7).contains(row));
    }
    let value =
        0.5 * z.dot(&product(&sparse.p, true)) + z.dot(&DVector::from_column_slice(&sparse.q));
    let constant = 0.5
        * (0..NU)
            .map(|i| qp.r_d[i] * qp.u_prev[i].powi(2))
            .sum::<f64>();
    assert!((value + constant - cost(&qp, &solution.u)).abs() < 1e-8);
}
