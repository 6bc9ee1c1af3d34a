//! The operating trajectory along which the ensemble is linearised.
#![allow(clippy::unwrap_used)]

use egp_core::settings::Operating;
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

/// While the window fills, a plan about states that contradict the ensemble is found in more than one QP.
#[test]
fn plans_are_repeated_while_the_window_fills_and_the_guess_contradicts_the_ensemble() {
    let request = warm();
    let transitions = request.history_y.len() / 3;
    let plan = |disturbed: f64, window: usize| {
        let mut request = request.clone();
        for (t, row) in request.plan_x.as_chunks_mut::<7>().0.iter_mut().enumerate() {
            row[OMEGA] += if t % 2 == 0 { disturbed } else { -disturbed };
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
    assert_eq!(plan(0.0, full), plan(0.0, fills), "the guess is consistent");
    let undisturbed = plan(0.0, full);
    let once = worst(&plan(0.6, full), &undisturbed);
    let repeated = worst(&plan(0.6, fills), &undisturbed);
    assert!(repeated < 0.5 * once, "{repeated} after {once}");
}
