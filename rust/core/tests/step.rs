//! The control step as a whole: properties of plans, and refusals.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::semicolon_if_nothing_returned
)]

mod support;

use std::f64::consts::{PI, TAU};
use std::sync::OnceLock;

use egp_core::settings::Operating;
use egp_core::{
    Kernel, Library, Settings, Status, StepError, StepReply, StepRequest, Workspace, step,
};

fn library() -> &'static Library {
    static LIBRARY: OnceLock<Library> = OnceLock::new();
    LIBRARY.get_or_init(|| support::library(Kernel::Rbf, &[0.5, 1.1], 250, 3))
}

/// A request that owns its numbers: driving a left-hand circle of 60 m radius at 14 m/s, half a metre beside it.
#[derive(Clone)]
struct Request {
    x: [f64; 7],
    u_prev: [f64; 2],
    weights: Vec<f64>,
    plan_x: Vec<f64>,
    plan_u: Vec<f64>,
    plan_shift: u32,
    history_z: Vec<f64>,
    history_y: Vec<f64>,
    history_f: Vec<f64>,
    reference: Vec<f64>,
    widths: Vec<f64>,
}

impl Request {
    fn circle() -> Self {
        let (radius, speed, dt) = (60.0, 14.0, 0.05);
        let reference = (0..=20).flat_map(|t| {
            let angle = speed * dt * f64::from(t) / radius;
            [
                radius * angle.sin(),
                radius * (1.0 - angle.cos()),
                speed,
                angle,
            ]
        });
        let history = |i: u32| {
            [
                13.5 + 0.1 * f64::from(i),
                0.05,
                0.2,
                0.04,
                500.0 - 90.0 * f64::from(i),
                0.01,
            ]
        };
        Self {
            x: [0.1, -0.5, 13.0, 0.05, 0.02, 0.1, 0.03],
            u_prev: [300.0, 0.05],
            weights: vec![],
            plan_x: vec![],
            plan_u: vec![],
            plan_shift: 1,
            history_z: (0..10).flat_map(history).collect(),
            history_y: (0..10)
                .flat_map(|i| [0.01, 0.02 - 0.001 * f64::from(i), 0.005])
                .collect(),
            history_f: vec![],
            reference: reference.collect(),
            widths: [3.0, 3.0].repeat(21),
        }
    }

    fn borrow(&self) -> StepRequest<'_> {
        StepRequest {
            x: &self.x,
            u_prev: &self.u_prev,
            weights: &self.weights,
            plan_x: &self.plan_x,
            plan_u: &self.plan_u,
            plan_shift: self.plan_shift,
            history_z: &self.history_z,
            history_y: &self.history_y,
            history_f: &self.history_f,
            reference: &self.reference,
            widths: &self.widths,
            want_sigma: false,
        }
    }

    /// The same situation turned by `angle` about the origin and moved by `by`.
    fn moved(&self, angle: f64, by: [f64; 2]) -> Self {
        let (sin, cos) = angle.sin_cos();
        let mut moved = self.clone();
        let place = |p: &mut [f64], psi: usize| {
            (p[0], p[1]) = (
                cos * p[0] - sin * p[1] + by[0],
                sin * p[0] + cos * p[1] + by[1],
            );
            p[psi] += angle;
        };
        place(&mut moved.x, 3);
        moved.reference.chunks_mut(4).for_each(|row| place(row, 3));
        moved.plan_x.chunks_mut(7).for_each(|row| place(row, 3));
        moved
    }

    /// Takes over what a client carries.
    fn carry(&mut self, reply: &StepReply) {
        self.plan_x.clone_from(&reply.plan_x);
        self.plan_u.clone_from(&reply.plan_u);
        self.weights.clone_from(&reply.weights);
        self.history_f.clone_from(&reply.history_f);
    }
}

fn solve(request: &Request, settings: &Settings) -> StepReply {
    let mut reply = StepReply::default();
    let mut ws = Workspace::new(library(), settings).unwrap();
    step(library(), settings, &request.borrow(), &mut ws, &mut reply).unwrap();
    reply
}

/// A warm request: the circle with the plan of a cold start.
fn warm() -> Request {
    let mut request = Request::circle();
    request.carry(&solve(&request, &Settings::default()));
    request.plan_shift = 0;
    request
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

#[test]
fn a_plan_keeps_the_bounds_and_approaches_the_reference() {
    let settings = Settings::default();
    for request in [Request::circle(), warm()] {
        let reply = solve(&request, &settings);
        assert_eq!(reply.status, Status::Solved);
        assert!(reply.kkt_residual < settings.solver.kkt_tolerance);
        assert_eq!((reply.plan_x.len(), reply.plan_u.len()), (21 * 7, 20 * 2));
        assert_eq!(reply.plan_x[..7], request.x);
        let mut before = request.u_prev;
        for u in reply.plan_u.as_chunks::<2>().0 {
            assert!((-8.0 - 1e-5..=6.0 + 1e-5).contains(&(u[0] / settings.mass)));
            assert!(u[1].abs() <= 0.4 + 1e-5);
            assert!(
                ((u[0] - before[0]) / settings.mass).abs() <= 3.0 + 1e-5
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
        request.carry(&solve(&request, &Settings::default()));
    }
    let shift = solve(&request, &Settings::default());
    let mut settings = Settings::default();
    settings.operating.kind = Operating::Rollout;
    let rollout = solve(&request, &settings);
    assert!(largest_difference(&shift.plan_x, &rollout.plan_x) < 1e-2);
}

#[test]
fn the_plan_moves_with_the_vehicle() {
    let request = warm();
    let settings = Settings::default();
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
fn whole_turns_change_nothing() {
    let request = warm();
    let plan = solve(&request, &Settings::default());
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
        let reply = solve(&turned, &Settings::default());
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
    let (a, b) = (
        solve(&straight, &Settings::default()),
        solve(&wrapped, &Settings::default()),
    );
    assert!(largest_difference(&a.plan_x, &b.plan_x) < 1e-8);
}

#[test]
fn the_same_request_gives_the_same_bits_whatever_came_before() {
    let settings = Settings::default();
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
fn carried_predictions_are_those_that_would_be_computed() {
    let settings = Settings::default();
    let request = Request::circle();
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

#[test]
fn weights_find_the_surface_and_stay_without_history() {
    let settings = Settings::default();
    for (member, expected) in library().members().iter().zip([[1.0, 0.0], [0.0, 1.0]]) {
        let mut request = Request::circle();
        request.history_z = (0..10)
            .flat_map(|i| [14.0, 0.1, 0.5, 0.1 + 0.02 * f64::from(i), 500.0, 0.1])
            .collect();
        request.history_y = request
            .history_z
            .as_chunks::<6>()
            .0
            .iter()
            .flat_map(|z| <[f64; 3]>::from(member.mean(&(*z).into())))
            .collect();
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
fn any_measured_state_gets_a_plan() {
    let settings = Settings::default();
    let base = Request::circle();
    for (name, change) in [
        (
            "standing",
            (|r: &mut Request| r.x[2] = 0.0) as fn(&mut Request),
        ),
        ("rolling back", |r| r.x[2] = -0.5),
        ("too fast", |r| r.x[2] = 75.0),
        ("off the track", |r| r.x[1] = -40.0),
        ("sliding sideways", |r| (r.x[4], r.x[5]) = (6.0, 2.5)),
        ("steering beyond the stop", |r| r.x[6] = 1.2),
        ("facing backwards", |r| r.x[3] = 3.1),
        ("braking beyond the limit", |r| {
            r.u_prev = [-30.0 * 1225.887, 3.0]
        }),
        ("driving beyond the limit", |r| {
            r.u_prev = [30.0 * 1225.887, -3.0]
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
fn track_edges_hold_the_plan_back() {
    let settings = Settings::default();
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
    // The right edge runs along the reference; 0.6 m of it and a margin of 1.1 m leave 0.5 m to the left.
    request.x[1] = 0.0;
    request.widths = [5.0, 0.6].repeat(21);
    let kept = lateral(&solve(&request, &settings));
    assert!(kept > 0.45, "{kept}");
    let mut free = request.clone();
    free.widths.clear();
    assert!(lateral(&solve(&free, &settings)) < 0.2);
}

#[test]
fn sigma_covers_noise_and_disagreement() {
    let settings = Settings::default();
    let request = warm();
    let mut ws = Workspace::new(library(), &settings).unwrap();
    let mut reply = StepReply::default();
    let mut wanted = request.borrow();
    wanted.want_sigma = true;
    step(library(), &settings, &wanted, &mut ws, &mut reply).unwrap();
    assert_eq!(reply.sigma.len(), 21 * 3);
    assert_eq!(reply.sigma[..3], [0.0; 3]);
    let noise = library()
        .members()
        .iter()
        .map(egp_core::Member::noise_std)
        .reduce(|a, b| a.inf(&b))
        .unwrap();
    for row in reply.sigma[3..].as_chunks::<3>().0 {
        assert!(
            (0..3).all(|o| row[o] >= noise[o] && row[o] < 2.0),
            "{row:?} {noise}"
        );
    }
}

#[test]
fn missed_periods_shift_the_plan_further() {
    let request = warm();
    for shift in [1, 3, 19, 20, 21, u32::MAX] {
        let mut late = request.clone();
        late.plan_shift = shift;
        assert_eq!(
            solve(&late, &Settings::default()).status,
            Status::Solved,
            "{shift}"
        );
    }
}

#[test]
fn malformed_requests_are_refused_by_field() {
    let settings = Settings::default();
    let mut ws = Workspace::new(library(), &settings).unwrap();
    let mut reply = StepReply::default();
    let mut refuse = |change: fn(&mut Request)| {
        let mut request = warm();
        change(&mut request);
        let error = step(library(), &settings, &request.borrow(), &mut ws, &mut reply).unwrap_err();
        assert!(reply.plan_u.is_empty() && reply.weights.is_empty());
        error
    };
    let shape = |error: StepError| match error {
        StepError::Shape { field, .. }
        | StepError::Window { field, .. }
        | StepError::NotFinite { field, .. } => field,
        other => panic!("{other}"),
    };
    assert_eq!(shape(refuse(|r| r.reference.truncate(80))), "reference");
    assert_eq!(shape(refuse(|r| r.widths.truncate(3))), "widths");
    assert_eq!(shape(refuse(|r| r.weights.push(0.0))), "weights");
    assert_eq!(shape(refuse(|r| r.plan_u.clear())), "plan_u");
    assert_eq!(shape(refuse(|r| r.plan_x.clear())), "plan_u");
    assert_eq!(shape(refuse(|r| r.plan_x.truncate(7))), "plan_x");
    assert_eq!(shape(refuse(|r| r.history_z.truncate(5))), "history_z");
    assert_eq!(shape(refuse(|r| r.history_y.truncate(27))), "history_y");
    assert_eq!(shape(refuse(|r| r.history_f.truncate(5))), "history_f");
    assert_eq!(shape(refuse(|r| r.history_z.extend([0.0; 6]))), "history_z");
    assert_eq!(shape(refuse(|r| r.reference[7] = f64::NAN)), "reference");
    assert_eq!(shape(refuse(|r| r.plan_u[3] = f64::INFINITY)), "plan_u");
    assert_eq!(shape(refuse(|r| r.history_f[3] = 1e300)), "history_f");
    assert!(matches!(
        refuse(|r| r.x[2] = 200.0),
        StepError::Domain { .. }
    ));
    assert!(matches!(
        refuse(|r| r.reference[0] = 2000.0),
        StepError::Domain { .. }
    ));
    assert!(matches!(
        refuse(|r| r.weights = vec![0.5, 0.6]),
        StepError::Weights { .. }
    ));
    assert!(matches!(
        refuse(|r| r.weights = vec![-0.1, 1.1]),
        StepError::Weights { .. }
    ));
    let other = Settings {
        horizon: 10,
        ..Settings::default()
    };
    let error = step(library(), &other, &warm().borrow(), &mut ws, &mut reply).unwrap_err();
    assert_eq!(error, StepError::Workspace);
}
