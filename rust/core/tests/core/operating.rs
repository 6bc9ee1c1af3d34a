//! The operating trajectory along which the ensemble is linearised.
#![allow(clippy::unwrap_used)]

use egp_core::settings::{Operating, SolverKind};
use egp_core::solver::Status;
use egp_testing::requests::{settings, solve, warm};

/// Index of the yaw rate in a state.
const OMEGA: usize = 5;

#[test]
fn plans_far_from_the_prediction_are_not_linearised_about() {
    let mut rollout = settings();
    rollout.operating.kind = Operating::Rollout;
    let warm = warm();
    // The plan with a lateral speed or a yaw rate that is larger by `by` at all stages.
    let with = |state: usize, by: f64| {
        let mut request = warm.clone();
        for row in request.plan_x.as_chunks_mut::<7>().0 {
            row[state] += by;
        }
        solve(&request, &settings()).plan_x
    };
    let predicted = solve(&warm, &rollout).plan_x;
    // Half of the box are 4 m/s and 1.5 rad/s. The warm plan itself is within 0.1 of the prediction.
    for (state, near, far) in [(4, 3.8, 4.2), (5, 1.3, 1.7)] {
        for sign in [1.0, -1.0] {
            assert_ne!(with(state, sign * near), predicted, "{state}");
            assert_eq!(with(state, sign * far), predicted, "{state}");
        }
    }
}

/// While the window fills, a plan about states that contradict the ensemble is found in more than one QP. It also fills after
/// transitions of a vehicle that stood, because no weights are estimated from these.
#[test]
fn plans_are_repeated_while_the_window_fills_and_the_guess_contradicts_the_ensemble() {
    let request = warm();
    let transitions = request.history_y.len() / 3;
    let plan = |disturbed: f64, window: usize, driven: usize| {
        let mut request = request.clone();
        for (t, row) in request.plan_x.as_chunks_mut::<7>().0.iter_mut().enumerate() {
            row[OMEGA] += if t % 2 == 0 { disturbed } else { -disturbed };
        }
        for row in &mut request.history_z.as_chunks_mut::<6>().0[driven..] {
            *row = [0.0; 6];
        }
        let mut settings = settings();
        settings.weights.window = Some(window);
        solve(&request, &settings).plan_x
    };
    let worst = |a: &[f64], b: &[f64]| {
        let differences = a.iter().zip(b).map(|(a, b)| (a - b).abs());
        differences.fold(0.0, f64::max)
    };
    let (full, fills) = (transitions, transitions + 1);
    let undisturbed = plan(0.0, full, transitions);
    assert_eq!(
        undisturbed,
        plan(0.0, fills, transitions),
        "the guess is consistent"
    );
    let once = worst(&plan(0.6, full, transitions), &undisturbed);
    let repeated = worst(&plan(0.6, fills, transitions), &undisturbed);
    assert!(repeated < 0.5 * once, "{repeated} after {once}");
    let stood = transitions - 1;
    let repeated = worst(&plan(0.6, full, stood), &plan(0.0, full, stood));
    assert!(repeated < 0.5 * once, "{repeated} after standing");
}

/// A repetition that ends at the limit of iterations does not take the first plan away.
#[test]
fn a_plan_stays_solved_if_its_repetition_is_not() {
    let warm = warm();
    let full = warm.history_y.len() / 3;
    let mut kept = 0;
    for disturbed in [-0.8, -1.0, -1.2] {
        let mut request = warm.clone();
        for row in &mut request.plan_x.as_chunks_mut::<7>().0[..7] {
            row[OMEGA] += disturbed;
        }
        for max_iterations in 7..10 {
            let reply = |window: usize| {
                let mut settings = settings();
                settings.weights.window = Some(window);
                settings.solver.kind = SolverKind::Clarabel;
                settings.solver.max_iterations = max_iterations;
                solve(&request, &settings)
            };
            let (once, repeated) = (reply(full), reply(full + 1));
            if once.status == Status::Solved {
                assert_eq!(
                    repeated.status,
                    Status::Solved,
                    "{disturbed} {max_iterations}"
                );
                kept += usize::from(repeated.plan_x == once.plan_x);
            }
        }
    }
    assert!(kept > 0);
}
