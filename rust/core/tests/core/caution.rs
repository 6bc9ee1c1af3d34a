//! Constraints tightened by the uncertainty of the plan.
#![allow(clippy::unwrap_used)]

use egp_core::ocp::{Caution, TransitionUncertainty};
use egp_core::qp::{OcpQp, SoftRow};
use egp_core::{GpOutput, Input, State, Status};
use egp_testing::requests::{Request, settings, solve};
use proptest::prelude::*;

const EDGE: f64 = 1.5;

/// A vehicle that moves straight along x at 10 m/s with lateral speed, yaw and yaw rate as integrators, between two edges.
fn corridor(horizon: usize) -> OcpQp {
    let dt = 0.1;
    let mut qp = OcpQp::new(horizon, 3);
    for stage in qp.stages_mut() {
        stage.a[(0, 2)] = dt;
        stage.a[(1, 4)] = dt;
        stage.a[(1, 3)] = 10.0 * dt;
        stage.a[(3, 5)] = dt;
        stage.b[(2, 0)] = dt;
        stage.b[(6, 1)] = dt;
        stage.a[(5, 6)] = dt;
        stage.soft[0] = SoftRow {
            normal: State::ith(2, 1.0),
            lower: 0.0,
            upper: 20.0,
        };
        stage.soft[2] = SoftRow {
            normal: State::ith(1, 1.0),
            lower: -EDGE,
            upper: EDGE,
        };
    }
    qp.r = Input::new(1e8, 1e8); // a regulator that hardly acts, so that the deviations are those of the open loop
    qp
}

fn disturbance(variance: [f64; 3], friction: [f64; 3]) -> TransitionUncertainty {
    TransitionUncertainty {
        variance: GpOutput::from(variance),
        friction: GpOutput::from(friction),
    }
}

#[test]
fn edges_move_by_the_deviations_of_sums() {
    // y_t is the sum of dt v_y, and v_y the sum of t independent changes: their weights are dt (t-1), dt (t-2), ... 0.
    let (horizon, std, kappa) = (6, 0.2, 2.0);
    let mut qp = corridor(horizon);
    let independent = vec![disturbance([0.0, std * std, 0.0], [0.0; 3]); horizon];
    Caution::new(horizon).tighten(kappa, &independent, &mut qp);
    for (t, stage) in qp.stages().iter().enumerate() {
        let squares: f64 = (0..=t).map(|k| (0.1 * k as f64 * std).powi(2)).sum();
        let expected = EDGE - kappa * squares.sqrt();
        assert!((stage.soft[2].upper - expected).abs() < 1e-6, "{t}");
        assert!((stage.soft[2].lower + expected).abs() < 1e-6, "{t}");
        assert_eq!(stage.soft[0].upper, 20.0);
    }
    // Changes that are the same at all stages add up.
    let mut qp = corridor(horizon);
    let common = vec![disturbance([0.0; 3], [0.0, std, 0.0]); horizon];
    Caution::new(horizon).tighten(kappa, &common, &mut qp);
    for (t, stage) in qp.stages().iter().enumerate() {
        let sum: f64 = (0..=t).map(|k| 0.1 * k as f64 * std).sum();
        let expected = (EDGE - kappa * sum).max(0.0);
        assert!((stage.soft[2].upper - expected).abs() < 1e-6, "{t}");
    }
}

#[test]
fn the_highest_speed_falls_by_the_deviation_of_the_speed() {
    let mut qp = corridor(3);
    let uncertain = vec![disturbance([0.04, 0.0, 0.0], [0.1, 0.0, 0.0]); 3];
    Caution::new(3).tighten(1.0, &uncertain, &mut qp);
    for (t, stage) in qp.stages().iter().enumerate() {
        let count = t as f64 + 1.0;
        let expected = 20.0 - (0.04 * count + (0.1 * count).powi(2)).sqrt();
        assert!((stage.soft[0].upper - expected).abs() < 1e-6, "{t}");
    }
}

#[test]
fn feedback_keeps_the_deviations_smaller() {
    let horizon = 30;
    let uncertain = vec![disturbance([0.0, 1e-4, 1e-5], [0.0; 3]); horizon];
    let last = |weight: f64| {
        let mut qp = corridor(horizon);
        qp.r = Input::new(weight, weight);
        Caution::new(horizon).tighten(1.0, &uncertain, &mut qp);
        qp.stages()[horizon - 1].soft[2].upper
    };
    assert!(last(0.1) > last(1e8) + 0.05, "{} {}", last(0.1), last(1e8));
}

#[test]
fn a_cautious_plan_keeps_away_from_the_edge_it_would_touch() {
    // The reference is 0.5 m beyond the edge.
    let mut request = Request::circle();
    request.x[1] = 0.6;
    request.widths = [3.0, -0.5].repeat(21);
    let mut settings = settings();
    settings.soft.edge_margin = Some(0.0);
    let lateral = |kappa: f64| {
        let mut settings = settings.clone();
        settings.soft.caution = kappa;
        let reply = solve(&request, &settings);
        assert_eq!(reply.status, Status::Solved);
        let rows = (reply.plan_x.as_chunks::<7>().0.iter())
            .zip(request.reference.as_chunks::<4>().0)
            .skip(15);
        rows.map(|(x, r)| (x[1] - r[1]) * r[3].cos() - (x[0] - r[0]) * r[3].sin())
            .fold(f64::INFINITY, f64::min)
    };
    let [none, one, two] = [0.0, 1.0, 2.0].map(lateral);
    assert!((none - 0.5).abs() < 0.05, "{none} {one} {two}");
    assert!(one > none + 0.01 && two > one + 0.01, "{none} {one} {two}");
}

proptest! {
    #[test]
    fn edges_never_cross(
        kappa in 0.0..10.0, variance in [0.0..1.0, 0.0..1.0, 0.0..1.0], friction in [-1.0..1.0, -1.0..1.0, -1.0..1.0],
    ) {
        let mut qp = corridor(10);
        let before = qp.clone();
        Caution::new(10).tighten(kappa, &[disturbance(variance, friction); 10], &mut qp);
        prop_assert!(qp.is_well_posed() && qp.keeps_pattern());
        for (stage, before) in qp.stages().iter().zip(before.stages()) {
            for (row, before) in stage.soft.iter().zip(&before.soft) {
                prop_assert!(row.lower >= before.lower && row.upper <= before.upper);
            }
        }
    }
}
