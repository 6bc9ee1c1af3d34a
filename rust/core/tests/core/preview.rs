//! What a request says about the road ahead, and the plan that follows from it.
#![allow(clippy::unwrap_used, clippy::panic)]

use egp_core::library::encode;
use egp_core::preview::StageWeights;
use egp_core::{GpInput, GpOutput, Kernel, Library, StepReply, Workspace, step};
use egp_testing::libraries;
use egp_testing::requests::{library, settings, solve, warm};

/// Weights of the stages for members of the frictions 1.0, 0.4 and 0.7.
fn stages(weights: [f64; 3], behind: f64, ahead: &[f64]) -> Vec<[f64; 3]> {
    let library = libraries::library(Kernel::Rbf, &[1.0, 0.4, 0.7], 20, 3);
    let mut stages = StageWeights::new(library.members(), ahead.len());
    let frictions = [behind].into_iter().chain(ahead.iter().copied());
    let road: Vec<[f64; 2]> = frictions.map(|mu| [mu, 0.1]).collect();
    stages.fill(&weights, &road, &settings().weights);
    (0..ahead.len())
        .map(|t| stages.stage(t).try_into().unwrap())
        .collect()
}

/// A library with members of these frictions, whose labels differ.
fn labelled(frictions: &[f64]) -> Library {
    let mut spec = libraries::spec(Kernel::Rbf, frictions, 20, 3);
    for (i, member) in spec.members.iter_mut().enumerate() {
        member.label = format!("member {i}");
    }
    Library::from_bytes(&encode(&spec).unwrap()).unwrap()
}

fn close(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
}

#[test]
fn a_road_that_does_not_change_leaves_the_weights_as_they_are() {
    let weights = [0.3, 0.6, 0.1];
    for row in stages(weights, 0.55, &[0.55; 4]) {
        assert!(close(&row, &weights));
    }
    let mut stages = StageWeights::new(library().members(), 3);
    stages.fill(&[0.25, 0.75], &[], &settings().weights);
    assert!((0..=3).all(|t| stages.stage(t) == [0.25, 0.75]));
}

#[test]
fn weights_move_to_the_members_of_the_friction_ahead() {
    let rows = stages([0.5, 0.0, 0.5], 0.85, &[0.85, 0.7, 0.55, 0.4, 0.2, 1.2]);
    let expected = [
        [0.5, 0.0, 0.5],
        [0.0, 0.0, 1.0],
        [0.0, 0.5, 0.5],
        [0.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0],
    ];
    for (row, expected) in rows.iter().zip(expected) {
        assert!(close(row, &expected), "{row:?} {expected:?}");
    }
}

#[test]
fn weights_that_contradict_the_preview_stay_on_the_simplex() {
    // The window fits the lowest friction, although the road behind is expected to have the highest.
    let rows = stages([0.0, 1.0, 0.0], 1.0, &[0.4, 0.7]);
    assert!(close(&rows[0], &[0.0, 1.0, 0.0]));
    assert!(close(&rows[1], &[0.0, 0.5, 0.5]));
}

#[test]
fn members_of_the_same_friction_share_its_weight() {
    let library = labelled(&[0.9, 0.3, 0.9]);
    let mut stages = StageWeights::new(library.members(), 3);
    let mut fill = |weights: [f64; 3], road: [f64; 4]| -> Vec<[f64; 3]> {
        stages.fill(&weights, &road.map(|mu| [mu, 0.1]), &settings().weights);
        (0..3)
            .map(|t| stages.stage(t).try_into().unwrap())
            .collect()
    };
    let rows = fill([0.75, 0.0, 0.25], [0.9, 0.3, 0.6, 0.9]);
    let expected = [[0.0, 1.0, 0.0], [0.375, 0.5, 0.125], [0.75, 0.0, 0.25]];
    for (row, expected) in rows.iter().zip(expected) {
        assert!(close(row, &expected), "{row:?} {expected:?}");
    }
    let rows = fill([0.0, 1.0, 0.0], [0.3, 0.9, 0.6, 0.3]);
    let expected = [[0.5, 0.0, 0.5], [0.25, 0.5, 0.25], [0.0, 1.0, 0.0]];
    for (row, expected) in rows.iter().zip(expected) {
        assert!(close(row, &expected), "{row:?} {expected:?}");
    }
}

#[test]
fn the_slope_over_the_friction_is_between_different_frictions() {
    let library = labelled(&[0.9, 0.3, 0.9]);
    let [first, low, last] = library.members() else {
        panic!("three members")
    };
    let stages = StageWeights::new(library.members(), 3);
    let z = GpInput::from([12.0, 0.1, 0.2, 0.02, 500.0, 0.0]);
    let expected = ((first.mean(&z) + last.mean(&z)) / 2.0 - low.mean(&z)) / 0.6;
    for mu in [0.2, 0.5, 0.9, 1.2] {
        let found = stages.slope(library.members(), mu, &z);
        assert!((found - expected).amax() < 1e-12 * expected.amax());
    }
    // Between frictions that are equal up to rounding the slope would be that of rounding errors.
    for other in [0.9, 0.900_000_1] {
        let same = labelled(&[0.9, other]);
        let stages = StageWeights::new(same.members(), 3);
        assert_eq!(stages.slope(same.members(), 0.9, &z), GpOutput::zeros());
    }
}

#[test]
fn known_weights_ahead_make_the_plan_of_a_vehicle_that_has_them() {
    // The window shows the first member, and the road changes to the second one at once: this is the plan of the second
    // member.
    let mut request = warm();
    for field in [&mut request.history_z, &mut request.history_y] {
        field.clear();
    }
    request.history_f.clear();
    request.weights = vec![0.0, 1.0];
    let expected = solve(&request, &settings());
    request.weights = vec![1.0, 0.0];
    let unaware = solve(&request, &settings());
    request.road_friction = [[0.5, 0.05]]
        .into_iter()
        .chain([[1.1, 0.05]; 21])
        .flatten()
        .collect();
    let aware = solve(&request, &settings());
    assert_eq!(aware.plan_x, expected.plan_x);
    assert_ne!(unaware.plan_x, expected.plan_x);
    assert_eq!(
        aware.weights,
        [1.0, 0.0],
        "the weights of the window are returned"
    );
}

#[test]
fn a_change_ahead_changes_the_deviations_after_it() {
    let mut request = warm();
    request.weights = vec![1.0, 0.0];
    request.history_z.clear();
    request.history_y.clear();
    request.history_f.clear();
    let mut ws = Workspace::new(library(), &settings()).unwrap();
    let mut sigma = |road: &[f64]| {
        let mut reply = StepReply::default();
        request.road_friction = road.to_vec();
        let borrowed = egp_core::StepRequest {
            want_sigma: true,
            ..request.borrow()
        };
        step(library(), &settings(), &borrowed, &mut ws, &mut reply).unwrap();
        reply.sigma
    };
    let row = |t: usize| if t < 11 { [0.5, 0.1] } else { [0.8, 0.1] };
    let road: Vec<f64> = (0..22).flat_map(row).collect();
    let (same, changed) = (sigma(&[0.5, 0.1].repeat(22)), sigma(&road));
    assert_eq!(same, sigma(&[]));
    // Members disagree where two of them have weight, from the transition of stage 10 on.
    let larger = |t: usize| (0..3).any(|o| changed[3 * t + o] > 1.05 * same[3 * t + o]);
    assert!((12..=20).all(larger), "{changed:?} {same:?}");
}
