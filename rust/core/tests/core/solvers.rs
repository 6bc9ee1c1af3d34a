//! The Riccati solver on random drives: KKT residuals and agreement with Clarabel. Every solver: repeatability.
#![allow(clippy::unwrap_used)]

use egp_core::Input;
use egp_core::qp::{MAX_SOFT, OcpQp, OcpSolution};
use egp_core::settings::{SolverKind, SolverSettings};
use egp_core::solver::{ClarabelSolver, QpSolver, RiccatiSolver, Status, solve_checked, solvers};
use egp_testing::drives::{Drive, shifted};

/// Consecutive problems of a drive.
const STEPS: usize = 5;

fn settings() -> SolverSettings {
    SolverSettings {
        max_iterations: 100,
        kkt_tolerance: 1e-6,
        ..SolverSettings::default()
    }
}

/// Number of problems for each horizon; `EGP_PROBLEMS` overrides it for a longer run.
fn count(default: usize) -> usize {
    std::env::var("EGP_PROBLEMS").map_or(default, |count| count.parse().unwrap())
}

/// Calls `judge` for `count` problems of drives; the guess is the shifted solution of the problem before, or empty.
fn drive(horizon: usize, count: usize, mut judge: impl FnMut(usize, &OcpQp, &[Input])) {
    let mut solver = RiccatiSolver::new(horizon, &settings());
    let mut out = OcpSolution::new(horizon);
    for n in (0..count).step_by(STEPS) {
        let mut drive = Drive::new((1000 * horizon + n) as u64);
        let mut qp = drive.problem(horizon);
        let mut guess = Vec::new();
        for step in 0..STEPS {
            judge(n + step, &qp, &guess);
            solve_checked(&mut solver, &qp, &[], settings().kkt_tolerance, &mut out);
            drive.successor(&mut qp, &out);
            guess = shifted(&out.u);
        }
    }
}

#[test]
fn every_solution_satisfies_the_kkt_conditions_cold_and_warm() {
    for horizon in [1, 10, 20, 40, 60] {
        let mut solver = RiccatiSolver::new(horizon, &settings());
        let mut out = OcpSolution::new(horizon);
        let (mut longest, mut worst, mut solved) = (0, 0.0_f64, 0);
        drive(horizon, count(500), |n, qp, guess| {
            let mut starts = vec![&guess[..0]];
            if !guess.is_empty() {
                starts.push(guess);
            }
            for start in starts {
                let status =
                    solve_checked(&mut solver, qp, start, settings().kkt_tolerance, &mut out);
                let (warm, iterations, kkt) = (!start.is_empty(), out.iterations, out.kkt);
                assert_eq!(
                    status,
                    Status::Solved,
                    "horizon {horizon}, problem {n}, warm {warm}: {iterations} iterations, {kkt:?}"
                );
                longest = longest.max(iterations);
                worst = worst.max(kkt.worst());
                solved += 1;
            }
        });
        println!(
            "horizon {horizon}: {solved} solved, at most {longest} iterations, residual at most {worst:.1e}"
        );
    }
}

#[test]
fn inputs_agree_with_clarabel() {
    let tight = SolverSettings {
        tolerance: 1e-12,
        ..settings()
    };
    for horizon in [10, 20, 40] {
        let mut default = RiccatiSolver::new(horizon, &settings());
        let mut riccati = RiccatiSolver::new(horizon, &tight);
        let mut clarabel = ClarabelSolver::new(&OcpQp::new(horizon, MAX_SOFT), &tight).unwrap();
        let (mut ours, mut theirs) = (OcpSolution::new(horizon), OcpSolution::new(horizon));
        let mut usual = OcpSolution::new(horizon);
        let mut apart = 0;
        drive(horizon, count(100), |n, qp, guess| {
            for (solver, out) in [(&mut riccati, &mut ours), (&mut default, &mut usual)] {
                assert_eq!(solve_checked(solver, qp, guess, 1e-6, out), Status::Solved);
            }
            assert!(distance(&ours, &usual) <= 1e-6);
            solve_checked(&mut clarabel, qp, &[], 1e-6, &mut theirs);
            let worst = distance(&ours, &theirs);
            let (mine, other) = (ours.kkt.worst(), theirs.kkt.worst());
            // Over long horizons Clarabel does not reach the tolerance on one problem in fifty. With a weakly active
            // bound the error of the inputs is as large as the square root of the residual.
            let inexact = other > 1e-6 || worst < other.sqrt();
            assert!(
                worst <= 1e-6 || mine < other && inexact,
                "horizon {horizon}, problem {n}: {worst:e}, residuals {mine:e} and {other:e}"
            );
            apart += usize::from(worst > 1e-6);
        });
        let most = if horizon < 40 {
            0
        } else {
            count(100).div_ceil(30)
        };
        assert!(
            apart <= most,
            "horizon {horizon}: {apart} are more than 1e-6 apart"
        );
    }
}

/// The largest difference of the inputs.
fn distance(one: &OcpSolution, other: &OcpSolution) -> f64 {
    let difference = one.u.iter().zip(&other.u).map(|(a, b)| (a - b).amax());
    difference.fold(0.0, f64::max)
}

#[test]
fn a_wrong_guess_does_not_change_the_solution() {
    let horizon = 20;
    let mut solver = RiccatiSolver::new(horizon, &settings());
    let (mut cold, mut warm) = (OcpSolution::new(horizon), OcpSolution::new(horizon));
    drive(horizon, 100, |n, qp, _| {
        solve_checked(&mut solver, qp, &[], 1e-6, &mut cold);
        for wrong in [
            [0.0, 0.0],
            [100.0, -7.0],
            [1e9, 1e9],
            [f64::NAN, f64::INFINITY],
        ] {
            let guess = vec![Input::from(wrong); horizon];
            let status = solve_checked(&mut solver, qp, &guess, 1e-6, &mut warm);
            assert_eq!(status, Status::Solved, "problem {n}, guess {wrong:?}");
            let worst = distance(&cold, &warm);
            assert!(worst < 1e-6, "problem {n}, guess {wrong:?}: {worst:e}");
        }
    });
}

#[test]
fn the_result_depends_on_problem_and_guess_alone() {
    let (one, other) = (Drive::new(7).problem(20), Drive::new(8).problem(20));
    let (mut first, mut second) = (OcpSolution::new(20), OcpSolution::new(20));
    for kind in SolverKind::ALL {
        let settings = SolverSettings { kind, ..settings() };
        let mut solver = solvers(&one, &settings).unwrap().remove(0);
        for guess in [vec![], vec![Input::new(1.0, 0.1); 20]] {
            solver.solve(&one, &guess, &mut first);
            solver.solve(&other, &guess, &mut second);
            solver.solve(&one, &guess, &mut second);
            assert_eq!(first, second, "{}", solver.name());
        }
    }
}

#[test]
fn a_problem_that_cannot_be_factorised_returns_nothing_of_the_problem_before() {
    let horizon = 20;
    let mut broken = Drive::new(8).problem(horizon);
    for stage in broken.stages_mut() {
        stage.q *= -1e9;
    }
    let mut expected = OcpSolution::new(horizon);
    let mut fresh = RiccatiSolver::new(horizon, &settings());
    let status = fresh.solve(&broken, &[], &mut expected);
    assert_eq!(status, Status::NumericalError);
    // With one iteration the interior-point method ends early, at multipliers that are not zero.
    let hasty = SolverSettings {
        max_iterations: 1,
        ..settings()
    };
    let (mut used, mut stale) = (RiccatiSolver::new(horizon, &hasty), 0);
    let mut out = OcpSolution::new(horizon);
    drive(horizon, 100, |n, qp, guess| {
        stale += usize::from(used.solve(qp, guess, &mut out) == Status::IterationLimit);
        assert_eq!(used.solve(&broken, &[], &mut out), status);
        assert_eq!(out, expected, "problem {n}");
    });
    assert!(stale > 0);
}
