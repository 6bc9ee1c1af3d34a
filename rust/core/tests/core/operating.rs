//! The operating trajectory along which the ensemble is linearised.
#![allow(clippy::unwrap_used)]

use egp_core::settings::Operating;
use egp_testing::requests::{settings, solve, warm};

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
