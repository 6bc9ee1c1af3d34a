//! The control step as a whole: properties of plans.
#![allow(clippy::unwrap_used, clippy::semicolon_if_nothing_returned)]

use std::f64::consts::{PI, TAU};

use egp_core::library::encode;
use egp_core::settings::Operating;
use egp_core::vehicle::ModelParameters;
use egp_core::{GpInput, Kernel, Library, Status, StepReply, Workspace, step};
use egp_testing::libraries;
use egp_testing::requests::{Request, library, settings, solve, warm};

use crate::mixture;

/// Mass of the vehicle that the tests' library is for, kg.
const MASS: f64 = egp_core::VehicleParameters::FORD_ESCORT.mass;

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

#[test]
fn a_plan_keeps_the_bounds_and_approaches_the_reference() {
    let settings = settings();
    for request in [Request::circle(), warm()] {
        let reply = solve(&request, &settings);
        assert_eq!(reply.status, Status::Solved);
        assert!(reply.kkt_residual < settings.solver.kkt_tolerance);
        assert_eq!((reply.plan_x.len(), reply.plan_u.len()), (21 * 7, 20 * 2));
        assert_eq!(reply.plan_x[..7], request.x);
        let mut before = request.u_prev;
        for u in reply.plan_u.as_chunks::<2>().0 {
            assert!((-8.0 - 1e-5..=6.0 + 1e-5).contains(&(u[0] / MASS)));
            assert!(u[1].abs() <= 0.4 + 1e-5);
            assert!(
                ((u[0] - before[0]) / MASS).abs() <= 3.0 + 1e-5
                    && (u[1] - before[1]).abs() <= 0.4 + 1e-5
            );
            before = *u;
        }
        let (last, target) = (&reply.plan_x[140..], &request.reference[80..]);
        assert!(
            (last[0] - target[0]).hypot(last[1] - target[1]) < 0.5,
            "{last:?} {target:?}"
        );
    }
}

#[test]
fn both_operating_trajectories_agree_where_the_plan_is_good() {
    let mut request = warm();
    for _ in 0..4 {
        request.carry(&solve(&request, &settings()));
    }
    let shift = solve(&request, &settings());
    let mut settings = settings();
    settings.operating.kind = Operating::Rollout;
    let rollout = solve(&request, &settings);
    assert!(largest_difference(&shift.plan_x, &rollout.plan_x) < 1e-2);
}

#[test]
fn the_plan_moves_with_the_vehicle() {
    let request = warm();
    let settings = settings();
    let plan = solve(&request, &settings);
    for (angle, by) in [
        (2.0, [0.0, 0.0]),
        (-3.1, [7e5, -5.2e6]),
        (0.0, [0.25, 1e4]),
        (9.0, [-40.0, 3.0]),
    ] {
        let there = solve(&request.moved(angle, by), &settings);
        let mut moved = request.clone();
        moved.plan_x.clone_from(&plan.plan_x);
        let expected = moved.moved(angle, by).plan_x;
        assert!(
            largest_difference(&there.plan_x, &expected) < 1e-6,
            "{angle} {by:?}"
        );
        assert!(
            largest_difference(&there.plan_u, &plan.plan_u) < 1e-3,
            "newtons"
        );
    }
}

#[test]
fn whole_turns_of_the_yaw_do_not_change_the_plan() {
    let request = warm();
    let plan = solve(&request, &settings());
    for (own, reference, old) in [
        (TAU, 0.0, 0.0),
        (0.0, -TAU, 0.0),
        (0.0, 0.0, 3.0 * TAU),
        (-2.0 * TAU, TAU, TAU),
    ] {
        let mut turned = request.clone();
        turned.x[3] += own;
        turned
            .reference
            .chunks_mut(4)
            .for_each(|row| row[3] += reference);
        turned.plan_x.chunks_mut(7).for_each(|row| row[3] += old);
        let reply = solve(&turned, &settings());
        assert!(
            largest_difference(&reply.plan_u, &plan.plan_u) < 1e-3,
            "newtons"
        );
        assert!(
            (reply.plan_x[143] - plan.plan_x[143] - own).abs() < 1e-9,
            "yaw continues the measured one"
        );
    }
    // A reference yaw that jumps from pi to -pi within the horizon.
    let turn = PI - 0.1 - request.x[3];
    let straight = request.moved(turn, [0.0; 2]);
    let mut wrapped = straight.clone();
    for row in wrapped.reference.chunks_mut(4) {
        row[3] = row[3].sin().atan2(row[3].cos());
    }
    assert!(wrapped.reference.chunks(4).any(|row| row[3] < 0.0));
    let (a, b) = (solve(&straight, &settings()), solve(&wrapped, &settings()));
    assert!(largest_difference(&a.plan_x, &b.plan_x) < 1e-8);
}

#[test]
fn the_bits_of_a_reply_do_not_depend_on_earlier_requests() {
    let settings = settings();
    let request = warm();
    let expected = solve(&request, &settings);
    let mut ws = Workspace::new(library(), &settings).unwrap();
    let mut reply = StepReply::default();
    for i in 0..20 {
        let mut other = Request::circle().moved(f64::from(i), [3.0, 4.0]);
        other.x[2] += 0.5 * f64::from(i);
        other.widths.clear();
        step(library(), &settings, &other.borrow(), &mut ws, &mut reply).unwrap();
        step(library(), &settings, &request.borrow(), &mut ws, &mut reply).unwrap();
        assert_eq!(reply, expected);
    }
}

#[test]
fn carried_predictions_equal_computed_ones() {
    let settings = settings();
    let request = cornering_on(&library().members()[0]);
    let fresh = solve(&request, &settings);
    assert_eq!(fresh.history_f.len(), 10 * 2 * 3);
    let mut carried = request.clone();
    carried.history_f = fresh.history_f[2 * 6..].to_vec(); // the newest two are missing
    assert_eq!(solve(&carried, &settings), fresh);
    carried.history_f.fill(0.0);
    assert_ne!(
        solve(&carried, &settings).weights,
        fresh.weights,
        "carried rows are used as given"
    );
}

/// A request whose history is that of a hard corner on a member's surface.
fn cornering_on(member: &egp_core::Member) -> Request {
    let mut request = Request::circle();
    request.history_z = (0..10)
        .flat_map(|i| [14.0, 0.1, 0.5, 0.1 + 0.02 * f64::from(i), 500.0, 0.1])
        .collect();
    let inputs = request.history_z.as_chunks::<6>().0.iter();
    request.history_y = inputs
        .flat_map(|z| <[f64; 3]>::from(member.mean(&(*z).into())))
        .collect();
    request
}

#[test]
fn a_window_that_does_not_tell_the_members_apart_leaves_the_weights() {
    let mut request = cornering_on(&library().members()[0]);
    request.weights = vec![0.3, 0.7];
    let mut settings = settings();
    assert_ne!(solve(&request, &settings).weights, request.weights);
    settings.weights.measurement = Some([50.0; 3]); // noise that hides every difference
    assert_eq!(solve(&request, &settings).weights, request.weights);
    settings.weights.whiten = false; // the paper's weights follow any window
    assert_ne!(solve(&request, &settings).weights, request.weights);
}

#[test]
fn weights_identify_the_surface_and_stay_constant_without_history() {
    let settings = settings();
    for (member, expected) in library().members().iter().zip([[1.0, 0.0], [0.0, 1.0]]) {
        let mut request = cornering_on(member);
        let mut weights = vec![];
        for _ in 0..20 {
            request.weights = weights;
            weights = solve(&request, &settings).weights;
        }
        assert!(
            largest_difference(&weights, &expected) < 0.05,
            "{weights:?}"
        );
    }
    let mut request = Request::circle();
    (request.history_z, request.history_y) = (vec![], vec![]);
    request.weights = vec![0.3, 0.7];
    assert!(largest_difference(&solve(&request, &settings).weights, &request.weights) < 1e-15);
}

#[test]
fn a_penalty_leaves_one_member_where_others_explain_little() {
    let mut request = cornering_on(&library().members()[0]);
    request.weights = vec![0.9, 0.1];
    let weights = |penalty| {
        let mut settings = settings();
        settings.weights.member_penalty = penalty;
        solve(&request, &settings).weights
    };
    let blend = weights(None);
    assert!(blend[1] > 0.0, "{blend:?}");
    assert_eq!(weights(Some(0.0)), blend);
    assert_eq!(weights(Some(100.0)), [1.0, 0.0]);
}

#[test]
fn any_measured_state_gets_a_plan() {
    let settings = settings();
    let base = Request::circle();
    for (name, change) in [
        (
            "standing",
            (|r: &mut Request| r.x[2] = 0.0) as fn(&mut Request),
        ),
        ("rolling back", |r| r.x[2] = -0.5),
        ("reference of a standstill, rounded", |r| {
            r.reference.chunks_mut(4).for_each(|row| row[2] = -1e-15)
        }),
        ("too fast", |r| r.x[2] = 75.0),
        ("off the track", |r| r.x[1] = -40.0),
        ("sliding sideways", |r| (r.x[4], r.x[5]) = (6.0, 2.5)),
        ("steering beyond the stop", |r| r.x[6] = 1.2),
        ("facing backwards", |r| r.x[3] = 3.1),
        ("braking beyond the limit", |r| {
            r.u_prev = [-30.0 * MASS, 3.0]
        }),
        ("driving beyond the limit", |r| {
            r.u_prev = [30.0 * MASS, -3.0]
        }),
        ("track of no width", |r| r.widths.fill(0.0)),
        ("track edge within edge", |r| r.widths.fill(-2.0)),
        ("reference far away", |r| {
            r.reference.chunks_mut(4).for_each(|row| row[0] += 300.0)
        }),
    ] {
        let mut request = base.clone();
        change(&mut request);
        let reply = solve(&request, &settings);
        assert_eq!(reply.status, Status::Solved, "{name}: {reply:?}");
        assert!(
            reply
                .plan_x
                .iter()
                .chain(&reply.plan_u)
                .all(|v| v.is_finite()),
            "{name}"
        );
    }
}

#[test]
fn the_plan_stays_within_the_track_edges() {
    let settings = settings();
    let mut request = Request::circle();
    let reference = request.reference.clone();
    let lateral = |reply: &StepReply| {
        let rows = reply
            .plan_x
            .as_chunks::<7>()
            .0
            .iter()
            .zip(reference.as_chunks::<4>().0);
        rows.skip(18)
            .map(|(x, r)| (x[1] - r[1]) * r[3].cos() - (x[0] - r[0]) * r[3].sin())
            .fold(f64::INFINITY, f64::min)
    };
    // The right edge is 0.6 m from the reference. With a margin of 1.1 m the plan must stay 0.5 m to the left.
    request.x[1] = 0.0;
    request.widths = [5.0, 0.6].repeat(21);
    let kept = lateral(&solve(&request, &settings));
    assert!(kept > 0.45, "{kept}");
    let mut free = request.clone();
    free.widths.clear();
    assert!(lateral(&solve(&free, &settings)) < 0.2);
}

#[test]
fn a_stated_slip_of_the_front_tyres_is_bounded_by_the_blended_friction() {
    let mut settings = settings();
    (settings.soft.slip, settings.soft.steering.linear) = (Some(0.1), Some(1e5));
    settings.cost.terminal = 1.0; // With more weight at the end consecutive plans alternate more.
    let mut request = Request::circle();
    (request.history_z, request.history_y) = (vec![], vec![]);
    request.widths.clear();
    request.x[1] = -4.0; // far enough from the path to need the largest allowed slip
    let front = library().vehicle().l_f;
    for (weights, friction) in [([1.0, 0.0], 0.5), ([0.5, 0.5], 0.8), ([0.0, 1.0], 1.1)] {
        request.weights = weights.to_vec();
        (request.plan_x, request.plan_u, request.plan_shift) = (vec![], vec![], 0);
        // Each plan is bounded by the states of the previous plan, and consecutive plans may alternate.
        let largest = [(); 8].map(|()| {
            request.carry(&solve(&request, &settings));
            let slip = |x: &[f64; 7]| (x[6] - ((x[4] + front * x[5]) / x[2]).atan()).abs();
            let states = request.plan_x.as_chunks().0.iter();
            states.map(slip).fold(0.0, f64::max)
        });
        let found = 0.5 * (largest[6] + largest[7]);
        assert!(
            (found - 0.1 * friction).abs() < 0.01,
            "{friction}: {largest:?}"
        );
    }
}

#[test]
fn by_default_the_slip_is_bounded_by_nine_tenths_of_the_members_blended_peaks() {
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 20, 0);
    // B and C of the front tyres; the second ones peak at a smaller slip, although the friction is larger.
    for (data, [stiffness, shape]) in spec.members.iter_mut().zip([[15.0, 1.6], [40.0, 1.35]]) {
        let vehicle = ModelParameters::SingleTrack([
            1225.0, 0.9, 1.5, 1.6, 0.45, 0.5, 0.8, 0.3, 0.3, 0.9, stiffness, shape, 0.3, 0.3, 1.1,
            20.0, 1.2,
        ]);
        libraries::leave_vehicle(data, vehicle);
    }
    let library = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
    let mut request = Request::circle();
    (request.history_z, request.history_y) = (vec![], vec![]);
    request.x[1] = -4.0; // far enough from the path to need the largest allowed slip
    let mut plan = |weights: [f64; 2], slip| {
        let mut settings = settings();
        settings.soft.slip = slip;
        request.weights = weights.to_vec();
        let mut ws = Workspace::new(&library, &settings).unwrap();
        let mut reply = StepReply::default();
        step(&library, &settings, &request.borrow(), &mut ws, &mut reply).unwrap();
        assert_eq!(reply.status, Status::Solved);
        reply.plan_x
    };
    let [first, second] = [0.9 * (PI / 3.2).tan() / 15.0, 0.9 * (PI / 2.7).tan() / 40.0];
    for (weights, friction, slip) in [
        ([1.0, 0.0], 0.5, first),
        ([0.5, 0.5], 0.8, 0.5 * (first + second)),
        ([0.0, 1.0], 1.1, second),
    ] {
        let (own, stated) = (plan(weights, None), plan(weights, Some(slip / friction)));
        let other = plan(weights, Some(1.1 * slip / friction));
        // Measured: 0, and at least 6.6e-3.
        assert!(largest_difference(&own, &stated) < 1e-9, "{weights:?}");
        assert!(largest_difference(&own, &other) > 3e-3, "{weights:?}");
    }
}

#[test]
fn sigma_covers_noise_and_disagreement() {
    let settings = settings();
    let request = warm();
    let mut ws = Workspace::new(library(), &settings).unwrap();
    let mut reply = StepReply::default();
    let mut wanted = request.borrow();
    wanted.want_sigma = true;
    step(library(), &settings, &wanted, &mut ws, &mut reply).unwrap();
    assert_eq!(reply.sigma.len(), 21 * 3);
    assert_eq!(reply.sigma[..3], [0.0; 3]);
    let rows = reply.sigma[3..].as_chunks::<3>().0.iter();
    let (states, inputs) = (reply.plan_x.as_chunks::<7>().0, &reply.plan_u);
    let transitions = states.iter().zip(inputs.as_chunks::<2>().0);
    for (row, (x, u)) in rows.zip(transitions) {
        let z = GpInput::from([x[2], x[4], x[5], x[6], u[0], u[1]]);
        let variance = mixture::variance(library().members(), &reply.weights, &z);
        for o in 0..3 {
            // Measured: 1 - 3e-13 to 1.018; the bound of the variance allows 1.11.
            let ratio = row[o] / variance[o].sqrt();
            assert!((1.0 - 1e-9..1.03).contains(&ratio), "{o}: {ratio} at {z}");
        }
    }
}

#[test]
fn measurement_noise_matters_only_in_a_whitened_window() {
    let weights = |whiten: bool, measurement: f64| {
        let mut settings = settings();
        settings.weights.whiten = whiten;
        settings.weights.measurement = Some([measurement; 3]);
        solve(&cornering_on(&library().members()[0]), &settings).weights
    };
    assert_ne!(weights(true, 0.0), weights(true, 0.03));
    assert_eq!(weights(false, 0.0), weights(false, 0.03));
}
