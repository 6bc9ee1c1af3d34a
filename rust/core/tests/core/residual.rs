//! The residual: what it estimates from errors, and what it changes in a step.
#![allow(clippy::unwrap_used)]

use egp_core::residual::ResidualFilter;
use egp_core::settings::ResidualSettings;
use egp_core::{GpOutput, Settings, StepReply, Workspace, step};
use egp_testing::requests::{Request, library, settings, solve, warm};

const DT: f64 = 0.05;

fn on() -> ResidualSettings {
    ResidualSettings {
        std: [0.05, 0.05, 0.0],
        time: [1.0, 1e4, 1.0],
        noise: [0.01, 0.01, 0.01],
        measurement: [0.0; 3],
    }
}

/// The estimate of least variance by Gauss's normal equations, with the covariances of the model written out.
fn best(errors: &[f64], s: f64, time: f64, v: f64, n: f64) -> (f64, f64, f64) {
    let k = errors.len();
    let lag = |i: usize| (-DT * f64::from(u32::try_from(i).unwrap()) / time).exp();
    let covariance = nalgebra::DMatrix::from_fn(k, k, |i, j| {
        let noise = match i.abs_diff(j) {
            0 => v * v + 2.0 * n * n,
            1 => -n * n,
            _ => 0.0,
        };
        s * s * lag(i.abs_diff(j)) + noise
    });
    let with_next = nalgebra::DVector::from_fn(k, |i, _| s * s * lag(k - i));
    let mut with_noise = nalgebra::DVector::zeros(k);
    if let Some(newest) = with_noise.iter_mut().last() {
        *newest = n * n;
    }
    let factor = covariance.cholesky().unwrap();
    let solved = factor.solve(&nalgebra::DVector::from_column_slice(errors));
    let variance = s * s - with_next.dot(&factor.solve(&with_next));
    (with_next.dot(&solved), with_noise.dot(&solved), variance)
}

#[test]
fn the_filter_is_the_estimate_of_least_variance() {
    let settings = ResidualSettings {
        measurement: [0.004, 0.0, 0.0],
        ..on()
    };
    let filter = ResidualFilter::new(&settings, DT, 10).unwrap();
    for count in [0_u32, 1, 2, 7, 10] {
        let errors: Vec<f64> = (0..count).map(|i| 0.01 * f64::from(i).cos()).collect();
        let rows = errors.iter().map(|e| GpOutput::repeat(*e));
        let found: Vec<_> = filter.estimate(rows).ahead().take(3).collect();
        for (output, n) in [(0, 0.004), (1, 0.0)] {
            let time = settings.time[output];
            let (b, noise, variance) = best(&errors, 0.05, time, 0.01, n);
            let decay = (-DT / time).exp();
            assert!((found[0].0[output] - (b - noise)).abs() < 1e-12);
            assert!((found[2].0[output] - decay * decay * b).abs() < 1e-12);
            assert!((found[0].1[output] - variance).abs() < 1e-12);
            assert!(found[2].1[output] >= found[0].1[output]);
        }
        assert_eq!((found[0].0[2], found[0].1[2]), (0.0, 0.0));
    }
}

#[test]
fn outliers_and_the_disturbance_are_limited() {
    let filter = ResidualFilter::new(&on(), DT, 10).unwrap();
    let estimate = |errors: &[f64]| {
        let rows = errors.iter().map(|e| GpOutput::repeat(*e));
        filter.estimate(rows).disturbance()
    };
    assert_eq!(estimate(&[0.0, 1.0]), estimate(&[0.0, 100.0]));
    assert!((estimate(&[10.0; 10])[1] - 0.15).abs() < 1e-12);
    assert!(ResidualFilter::new(&ResidualSettings::default(), DT, 10).is_none());
}

/// A request whose vehicle accelerates, in each transition, by 0.02 m/s more than the last request's members predict.
fn disturbed(mut request: Request, members: &[f64]) -> Request {
    for (y, f) in request.history_y.iter_mut().zip(members) {
        *y = *f;
    }
    for y in request.history_y.iter_mut().step_by(3) {
        *y += 0.02;
    }
    request
}

#[test]
fn a_plan_contains_the_disturbance_and_sigma_its_variance() {
    let mut request = warm();
    request.weights = vec![1.0, 0.0];
    let first: Vec<f64> = (solve(&request, &settings()).history_f.chunks_exact(6))
        .flat_map(|row| row[..3].to_vec())
        .collect();
    let request = disturbed(request, &first);
    let mut with = Settings {
        residual: on(),
        ..settings()
    };
    with.weights.prior = egp_core::settings::Prior::Quadratic { lambda: 1e9 };
    let mut without = with.clone();
    without.residual = ResidualSettings::default();
    let [told, untold] = [&with, &without].map(|settings| solve(&request, settings));
    assert_eq!(told.weights, untold.weights);
    // The same force accelerates the vehicle more, so that the plan needs less of it.
    let force = |plan: &[f64]| plan.iter().step_by(2).sum::<f64>();
    assert!(force(&told.plan_u) < force(&untold.plan_u) - 1.0);
    let [told, untold] = [&with, &without].map(|settings| {
        let mut reply = StepReply::default();
        let mut ws = Workspace::new(library(), settings).unwrap();
        let mut wanted = request.borrow();
        wanted.want_sigma = true;
        step(library(), settings, &wanted, &mut ws, &mut reply).unwrap();
        reply.sigma
    });
    for stage in 1..=20 {
        assert!(told[3 * stage] > 1.01 * untold[3 * stage]);
    }
}
