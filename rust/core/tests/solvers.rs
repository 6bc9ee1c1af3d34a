//! The structured solver against Clarabel on random driving problems, far outside of normal driving included.
#![allow(clippy::unwrap_used, clippy::too_many_lines)] // one problem is one long definition

use egp_core::qp::{MAX_SOFT, OcpQp, OcpSolution, SoftRow};
use egp_core::settings::{Penalty, SolverSettings};
use egp_core::solver::{ClarabelSolver, QpSolver, RiccatiSolver, Status, solve_checked};
use egp_core::{Input, NU, State};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Uniform in `[-1, 1)`.
fn unit(rng: &mut ChaCha8Rng) -> f64 {
    2.0 * rng.random::<f64>() - 1.0
}

/// A linearised car on a bent reference; a tenth starts far outside of its soft bounds, a tenth with an applied input
/// that the bounds do not allow.
fn driving_problem(rng: &mut ChaCha8Rng, horizon: usize) -> OcpQp {
    let dt = 0.05;
    let v = 14.0 + 11.0 * unit(rng);
    let (heading, bend) = (3.1 * unit(rng), 0.5 * unit(rng) * (8.0 / v).min(1.0));
    let wild = if rng.random::<f64>() < 0.1 { 5.0 } else { 1.0 };
    let mut qp = OcpQp::new(horizon, MAX_SOFT);
    qp.r = Input::new(0.05, 2.0);
    qp.r_d = Input::new(0.05, 5.0);
    qp.penalty = [Penalty {
        linear: 200.0,
        quadratic: 2000.0,
    }; MAX_SOFT];
    qp.x0 = State::from([
        0.5 * unit(rng),
        1.5 * wild * unit(rng),
        v + 2.0 * wild * unit(rng),
        heading + 0.2 * wild * unit(rng),
        wild * unit(rng),
        0.5 * wild * unit(rng),
        0.2 * wild * unit(rng),
    ]);
    let slew = Input::new(3.0, 0.4);
    let out_of_bounds = if rng.random::<f64>() < 0.1 { 2.0 } else { 0.9 };
    qp.u_prev = Input::new(
        5.0 * out_of_bounds * unit(rng),
        0.4 * out_of_bounds * unit(rng),
    );
    let (mut low, mut high) = (qp.u_prev, qp.u_prev);
    let (mut x, mut y, mut psi) = (0.0, 0.0, heading);
    let (damping, stiffness) = (0.2 + 0.15 * unit(rng), 3.0 + unit(rng));
    for (t, stage) in qp.stages_mut().iter_mut().enumerate() {
        let (sin, cos) = psi.sin_cos();
        stage.a = nalgebra::SMatrix::identity();
        stage.a[(0, 2)] = dt * cos;
        stage.a[(0, 3)] = -dt * v * sin;
        stage.a[(0, 4)] = -dt * sin;
        stage.a[(1, 2)] = dt * sin;
        stage.a[(1, 3)] = dt * v * cos;
        stage.a[(1, 4)] = dt * cos;
        stage.a[(2, 2)] = 0.99;
        stage.a[(2, 4)] = 0.05 * unit(rng);
        stage.a[(2, 5)] = 0.05 * unit(rng);
        stage.a[(3, 5)] = dt;
        stage.a[(4, 4)] = 1.0 - damping;
        stage.a[(4, 5)] = -dt * v * 0.6 * (1.0 + 0.2 * unit(rng));
        stage.a[(4, 6)] = stiffness;
        stage.a[(5, 4)] = 0.1 * unit(rng);
        stage.a[(5, 5)] = 1.0 - damping + 0.05 * unit(rng);
        stage.a[(5, 6)] = 0.7 * stiffness;
        stage.b = nalgebra::SMatrix::zeros();
        stage.b[(2, 0)] = dt;
        stage.b[(4, 1)] = 0.05;
        stage.b[(5, 1)] = 0.05;
        stage.b[(6, 1)] = dt;
        // Makes the kinematics exact about the reference.
        stage.c = State::from([
            dt * v * psi * sin,
            -dt * v * psi * cos,
            0.01 * v,
            0.0,
            0.02 * unit(rng),
            0.02 * unit(rng),
            0.0,
        ]);
        x += dt * v * cos;
        y += dt * v * sin;
        psi += dt * bend;
        let (sin, cos) = psi.sin_cos();
        let terminal = if t + 1 == horizon { 2.0 } else { 1.0 };
        let (lon, lat) = (10.0 * terminal, 20.0 * terminal);
        stage.q = nalgebra::SMatrix::zeros();
        stage.q[(0, 0)] = lon * cos * cos + lat * sin * sin;
        stage.q[(0, 1)] = (lon - lat) * sin * cos;
        stage.q[(1, 0)] = stage.q[(0, 1)];
        stage.q[(1, 1)] = lon * sin * sin + lat * cos * cos;
        stage.q[(2, 2)] = 2.0 * terminal;
        stage.q[(3, 3)] = 10.0 * terminal;
        stage.reference = State::from([x, y, v - 2.0 * bend.abs(), psi, 0.0, 0.0, 0.0]);
        stage.du_min = -slew;
        stage.du_max = slew;
        for i in 0..NU {
            // Bounds are widened to what the slew limits let the applied input reach.
            let (lower, upper) = ([-8.0, -0.4][i], [6.0_f64.min(54.7 / v), 0.4][i]);
            low[i] = f64::max(low[i] - slew[i], lower);
            high[i] = f64::min(high[i] + slew[i], upper);
            stage.u_min[i] = f64::min(lower, high[i]);
            stage.u_max[i] = f64::max(upper, low[i]);
            low[i] = low[i].clamp(stage.u_min[i], stage.u_max[i]);
            high[i] = high[i].clamp(stage.u_min[i], stage.u_max[i]);
        }
        let row = |index: usize, lower: f64, upper: f64| {
            let mut normal = State::zeros();
            normal[index] = 1.0;
            SoftRow {
                normal,
                lower,
                upper,
            }
        };
        let mut normal = State::zeros();
        normal[0] = -sin;
        normal[1] = cos;
        let offset = -sin * x + cos * y;
        stage.soft = [
            row(2, 0.0, v + 1.0),
            row(6, -0.91, 0.91),
            SoftRow {
                normal,
                lower: offset - 2.0,
                upper: offset + 2.0,
            },
            row(4, -3.0, 3.0),
            row(5, -1.5, 1.5),
        ];
    }
    qp
}

fn settings() -> SolverSettings {
    SolverSettings {
        max_iterations: 100,
        kkt_tolerance: 1e-6,
        ..SolverSettings::default()
    }
}

/// Problems a horizon; set `EGP_PROBLEMS` for a longer run.
fn count(default: usize) -> usize {
    std::env::var("EGP_PROBLEMS").map_or(default, |count| count.parse().unwrap())
}

#[test]
fn every_problem_passes_our_check() {
    for horizon in [1, 10, 20, 40, 60] {
        let mut rng = ChaCha8Rng::seed_from_u64(horizon as u64);
        let mut solver = RiccatiSolver::new(horizon, &settings());
        let mut out = OcpSolution::new(horizon);
        for n in 0..count(500) {
            let qp = driving_problem(&mut rng, horizon);
            let status = solve_checked(&mut solver, &qp, settings().kkt_tolerance, &mut out);
            let (iterations, kkt) = (out.iterations, out.kkt);
            assert_eq!(
                status,
                Status::Solved,
                "horizon {horizon}, problem {n}: {iterations} iterations, {kkt:?}"
            );
        }
    }
}

#[test]
fn inputs_agree_with_clarabel() {
    let tight = SolverSettings {
        tolerance: 1e-11,
        ..settings()
    };
    for horizon in [10, 20, 40] {
        let mut rng = ChaCha8Rng::seed_from_u64(100 + horizon as u64);
        let mut riccati = RiccatiSolver::new(horizon, &settings());
        let mut clarabel = ClarabelSolver::new(&OcpQp::new(horizon, MAX_SOFT), &tight).unwrap();
        let (mut ours, mut theirs) = (OcpSolution::new(horizon), OcpSolution::new(horizon));
        let mut compared = 0;
        for n in 0..count(100) {
            let qp = driving_problem(&mut rng, horizon);
            assert_eq!(
                solve_checked(&mut riccati, &qp, 1e-6, &mut ours),
                Status::Solved
            );
            solve_checked(&mut clarabel, &qp, 1e-6, &mut theirs);
            // Clarabel is the oracle only where it reached the accuracy asked of it.
            if theirs.kkt.worst() > 1e-10 {
                continue;
            }
            compared += 1;
            let difference = ours.u.iter().zip(&theirs.u).map(|(a, b)| (a - b).amax());
            let worst = difference.fold(0.0, f64::max);
            assert!(worst < 5e-5, "horizon {horizon}, problem {n}: {worst:e}");
        }
        assert!(
            compared > count(100) / 4,
            "only {compared} problems compared"
        );
    }
}

#[test]
fn the_result_depends_on_the_problem_alone() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (one, other) = (driving_problem(&mut rng, 20), driving_problem(&mut rng, 20));
    let mut solver = RiccatiSolver::new(20, &settings());
    let (mut first, mut second) = (OcpSolution::new(20), OcpSolution::new(20));
    solver.solve(&one, &mut first);
    solver.solve(&other, &mut second);
    solver.solve(&one, &mut second);
    assert_eq!(first, second);
}
