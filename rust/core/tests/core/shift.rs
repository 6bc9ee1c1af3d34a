//! The last plan, shifted by the control periods that have passed since.
#![allow(clippy::unwrap_used)]

use egp_core::settings::Operating;
use egp_core::{Status, StepReply};
use egp_testing::requests::{Request, settings, solve, warm};

#[test]
fn the_plan_is_shifted_by_the_missed_periods() {
    let request = warm();
    let late = |plan_shift| Request {
        plan_shift,
        ..request.clone()
    };
    // The states of a roll-out depend on the inputs of the plan only, of which the last one is held with constant angle.
    let mut settings = settings();
    settings.operating.kind = Operating::Rollout;
    let now = plan(solve(&late(0), &settings));
    for shift in [1, 3, 19] {
        let mut shifted = late(0);
        shifted.plan_u.drain(..2 * shift);
        let force = request.plan_u[38];
        shifted.plan_u.extend([force, 0.0].repeat(shift));
        shifted.plan_x.drain(..7 * shift);
        let end = request.plan_x[140..].repeat(shift);
        shifted.plan_x.extend(end);
        let found = plan(solve(&late(u32::try_from(shift).unwrap()), &settings));
        assert_eq!(found, plan(solve(&shifted, &settings)), "{shift}");
        assert_ne!(found, now, "{shift}");
    }
}

#[test]
fn the_operating_states_of_a_shifted_plan_begin_at_the_missed_periods() {
    let request = warm();
    let moved = |plan_shift, row: usize| {
        let mut late = Request {
            plan_shift,
            ..request.clone()
        };
        late.plan_x[7 * row + 2] += 0.1;
        plan(solve(&late, &settings()))
    };
    for shift in [1, 3, 18] {
        let row = shift as usize;
        // The measured state stands in place of the first row.
        let past = moved(shift, row);
        assert_eq!(past, moved(shift, row - 1), "{shift}");
        assert_ne!(past, moved(shift, row + 1), "{shift}");
        assert_ne!(past, moved(shift, row + 2), "{shift}");
    }
}

#[test]
fn a_plan_that_has_ended_is_no_plan() {
    let request = warm();
    let late = |plan_shift| Request {
        plan_shift,
        ..request.clone()
    };
    let cold = Request {
        plan_x: vec![],
        plan_u: vec![],
        ..request.clone()
    };
    let cold = plan(solve(&cold, &settings()));
    for shift in [20, 21, u32::MAX] {
        assert_eq!(plan(solve(&late(shift), &settings())), cold, "{shift}");
    }
    assert_ne!(plan(solve(&late(19), &settings())), cold);
}

/// States and inputs of a reply that has a plan.
fn plan(reply: StepReply) -> [Vec<f64>; 2] {
    assert_eq!(reply.status, Status::Solved);
    [reply.plan_x, reply.plan_u]
}
