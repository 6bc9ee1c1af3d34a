//! Velocities that are measured late: with their delay stated, the step is that of exact measurements.
#![allow(clippy::unwrap_used)]

use std::collections::VecDeque;

use egp_core::settings::{Prior, ResidualSettings};
use egp_core::step::SetupError;
use egp_core::{FrictionEstimate, GpInput, Member, Settings, StepReply, Workspace, step};
use egp_testing::requests::{Request, library, settings, solve};

const DT: f64 = 0.05;
/// Parts of a period in which the vehicle is simulated.
const PARTS: usize = 4;
/// Transitions of a request.
const WINDOW: usize = 30;

/// Inputs and steering angle of period `i`.
fn input(i: usize) -> [f64; 2] {
    let time = DT * f64::from(u32::try_from(i).unwrap());
    [700.0 * (7.0 * time).sin(), 0.9 * (9.0 * time).cos()]
}

/// Periods after which the requests of most tests are made.
const PERIODS: usize = 40;

/// [`request_after`] 40 periods.
fn request(member: &Member, late: usize) -> Request {
    request_after(member, late, PERIODS)
}

/// The request of a vehicle that has moved for `periods` as `member` predicts, whose velocities are `late` parts of a period
/// old. Within a period the changes are those at its start, as the step assumes.
fn request_after(member: &Member, late: usize, periods: usize) -> Request {
    let (mut v, mut delta) = ([13.0, 0.0, 0.1], 0.03);
    let mut past: VecDeque<[f64; 3]> = VecDeque::from(vec![v; late + 1]);
    let (mut rows, mut changes) = (vec![], vec![]);
    let mut measured = v;
    for i in 0..periods {
        let u = input(i);
        rows.push([measured[0], measured[1], measured[2], delta, u[0], u[1]]);
        let z = GpInput::new(v[0], v[1], v[2], delta, u[0], u[1]);
        let change = member.mean(&z);
        for _ in 0..PARTS {
            for (v, change) in v.iter_mut().zip(change.iter()) {
                *v += change / f64::from(u32::try_from(PARTS).unwrap());
            }
            past.push_back(v);
            past.pop_front();
        }
        delta += DT * u[1];
        let before = measured;
        measured = past[0];
        changes.push([0, 1, 2].map(|k| measured[k] - before[k]));
    }
    let mut request = Request::circle();
    let [p_x, p_y, _, psi, ..] = request.x;
    request.x = [p_x, p_y, measured[0], psi, measured[1], measured[2], delta];
    request.u_prev = input(periods - 1);
    request.history_z = rows.iter().rev().take(WINDOW).flatten().copied().collect();
    request.history_y = changes
        .iter()
        .rev()
        .take(WINDOW)
        .flatten()
        .copied()
        .collect();
    request
}

fn late(parts: usize) -> Settings {
    let mut settings = settings();
    settings.weights.window = Some(WINDOW);
    let parts = f64::from(u32::try_from(parts).unwrap());
    settings.measurement_delay = Some(parts * DT / f64::from(u32::try_from(PARTS).unwrap()));
    settings
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let differences = a.iter().zip(b).map(|(a, b)| (a - b).abs());
    differences.fold(0.0, f64::max)
}

#[test]
fn late_velocities_give_the_plan_of_present_ones() {
    let member = &library().members()[0];
    let known = |parts| {
        let mut request = request(member, parts);
        request.weights = vec![1.0, 0.0];
        request
    };
    let exact = solve(&known(0), &late(0)).plan_u;
    for parts in [4, 8, 12] {
        let told = solve(&known(parts), &late(parts)).plan_u;
        let untold = solve(&known(parts), &late(0)).plan_u;
        let [told, untold] = [told, untold].map(|plan| largest_difference(&plan[1..], &exact[1..]));
        assert!(told < 0.02 * untold, "{parts}: {told} {untold}");
    }
    // Between whole periods the change is taken at the wrong time, by part of a period.
    for parts in [1, 2, 3, 5, 6, 7] {
        let told = solve(&known(parts), &late(parts)).plan_u;
        let untold = solve(&known(parts), &late(0)).plan_u;
        let [told, untold] = [told, untold].map(|plan| largest_difference(&plan[1..], &exact[1..]));
        assert!(told < 0.3 * untold, "{parts}: {told} {untold}");
    }
}

#[test]
fn weights_and_friction_are_those_of_present_velocities() {
    for member in library().members() {
        let exact = solve(&request(member, 0), &late(0));
        let told = solve(&request(member, 8), &late(8));
        let untold = solve(&request(member, 8), &late(0));
        let [told, untold] = [told, untold].map(|reply| {
            [
                largest_difference(&reply.weights, &exact.weights),
                (reply.friction.mean - exact.friction.mean).abs(),
            ]
        });
        println!("{told:?} {untold:?}");
        for (told, untold) in told.into_iter().zip(untold) {
            assert!(told < 0.05 && told <= untold, "{told} {untold}");
        }
    }
}

#[test]
fn without_history_the_last_input_counts_as_applied_since() {
    let member = &library().members()[0];
    let mut request = request(member, 4);
    request.weights = vec![1.0, 0.0];
    (request.history_z, request.history_y) = (vec![], vec![]);
    let reply = solve(&request, &late(4));
    assert_eq!(reply.plan_x[..7], request.x);
    assert_ne!(reply.plan_u, solve(&request, &late(0)).plan_u);
}

#[test]
fn no_delay_changes_nothing() {
    let request = Request::circle();
    let stated = Settings {
        measurement_delay: Some(0.0),
        ..settings()
    };
    assert_eq!(solve(&request, &stated), solve(&request, &settings()));
}

/// Settings by which the errors of a window also change the plan, and weights follow it within a few periods.
fn late_with_residual(parts: usize) -> Settings {
    let mut settings = late(parts);
    settings.residual = ResidualSettings {
        std: [0.05; 3],
        ..ResidualSettings::default()
    };
    settings.weights.prior = Prior::Quadratic { lambda: 30.0 };
    settings
}

/// Number of rows of a history whose inputs were applied before it, at a delay of `parts`.
fn unknown(parts: usize) -> usize {
    parts.div_ceil(PARTS)
}

/// Consecutive requests with what a client carries between them, and their replies.
fn drive(member: &Member, parts: usize, periods: usize) -> Vec<(Request, StepReply)> {
    let mut steps: Vec<(Request, StepReply)> = vec![];
    for i in 1..=periods {
        let mut request = request_after(member, parts, i);
        if let Some((_, before)) = steps.last() {
            request.carry(before);
            // The oldest transition leaves a full window.
            let rows = request.history_z.len() / 6 - 1;
            request.history_f.truncate(rows * 6);
        }
        let reply = solve(&request, &late_with_residual(parts));
        steps.push((request, reply));
    }
    steps
}

#[test]
fn transitions_whose_inputs_are_not_in_the_request_count_for_nothing() {
    let member = &library().members()[0];
    for parts in [6, 8] {
        for (i, (request, reply)) in drive(member, parts, 45).into_iter().enumerate() {
            let rows = request.history_z.len() / 6;
            let of_unknown = 6 * (rows - unknown(parts).min(rows));
            // The members' predictions of these transitions, and what was measured, may be anything.
            let mut other = request.clone();
            let carried = 6 * (rows - request.history_f.len() / 6);
            if let Some(start) = of_unknown.checked_sub(carried) {
                other.history_f[start..].fill(0.7);
            }
            other.history_y[of_unknown / 2..].fill(-0.3);
            // Predictions that were carried are those that a step computes.
            let mut without = request.clone();
            without.history_f.clear();
            for changed in [other, without] {
                let again = solve(&changed, &late_with_residual(parts));
                let outcome = |reply: &StepReply| {
                    (reply.weights.clone(), reply.friction, reply.plan_u.clone())
                };
                assert_eq!(outcome(&again), outcome(&reply), "{parts} {i}");
            }
            if rows <= unknown(parts) {
                assert_eq!(reply.weights, [0.5, 0.5]);
                assert_eq!(reply.friction, FrictionEstimate::default());
            }
        }
    }
}

#[test]
fn from_the_first_requests_on_the_weights_are_those_of_present_velocities() {
    for member in library().members() {
        let exact = drive(member, 0, 45);
        let told = drive(member, 8, 45);
        // After two periods without known inputs, the windows have the same inputs and changes. The differences are 0.
        for (i, (told, exact)) in told[2..].iter().zip(&exact).enumerate() {
            let difference = largest_difference(&told.1.weights, &exact.1.weights);
            assert!(difference < 1e-12, "{i}: {difference}");
        }
    }
}

#[test]
fn standard_deviations_are_those_at_the_states_of_the_plan() {
    let member = &library().members()[0];
    let sigma = |velocities: usize, told: usize| {
        let mut request = request(member, velocities);
        request.weights = vec![1.0, 0.0];
        let mut wanted = request.borrow();
        wanted.want_sigma = true;
        let (settings, mut reply) = (late(told), StepReply::default());
        let mut ws = Workspace::new(library(), &settings).unwrap();
        step(library(), &settings, &wanted, &mut ws, &mut reply).unwrap();
        reply.sigma[3..6].to_vec()
    };
    let exact = sigma(0, 0);
    let [told, untold] = [sigma(8, 8), sigma(8, 0)].map(|sigma| largest_difference(&sigma, &exact));
    // 2.3e-15 and 0.017.
    assert!(told < 1e-3 * untold, "{told} {untold}");
}

#[test]
fn a_window_shorter_than_the_delay_is_an_error_with_both_settings() {
    let with = |window: usize, delay: f64| {
        let mut settings = settings();
        settings.weights.window = Some(window);
        settings.measurement_delay = Some(delay);
        Workspace::new(library(), &settings).map(|_| ())
    };
    // 0.14 s are 2.8 periods of 0.05 s, and 0.15 s three, although the quotient is larger by rounding.
    for (window, delay) in [(3, 0.14), (3, 3.0 * DT), (10, 0.5), (1, 0.0), (1, 0.05)] {
        with(window, delay).unwrap();
    }
    for (window, delay, least) in [(2, 0.14, 3), (2, 3.0 * DT, 3), (9, 0.5, 10), (1, 0.06, 2)] {
        let error = with(window, delay).unwrap_err();
        assert!(matches!(error, SetupError::Window { least: l, .. } if l == least));
        let text = error.to_string();
        for part in [
            format!("`weights.window` is {window} periods of 0.05 s"),
            format!("`measurement_delay` of {delay} s"),
            format!("to at least {least}"),
        ] {
            assert!(text.contains(&part), "{text}");
        }
    }
}
