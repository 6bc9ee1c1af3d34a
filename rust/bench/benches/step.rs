//! The control step and its phases: 2 members of 700 points, horizon 20, window 10.
//!
//! Run `cargo bench -p egp-bench --bench step`. The goal for the whole warm step is at most 5 ms.
#![allow(
    clippy::unwrap_used,
    clippy::semicolon_if_nothing_returned,
    missing_docs
)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use egp_core::linearisation::{Domain, Linearisation};
use egp_core::ocp::{self, Road, Setup, soft_rows};
use egp_core::settings::SolverKind;
use egp_core::solver::{ClarabelSolver, RiccatiSolver, solve_checked};
use egp_core::trajectory::Guess;
use egp_core::vehicle::TyreLimits;
use egp_core::weights::{WeightEstimator, WindowNoise};
use egp_core::{
    Ensemble, Input, Kernel, Library, OcpQp, OcpSolution, QpSolver, Settings, State, StepReply,
    StepRequest, Workspace, step,
};
use egp_testing::libraries;

/// A left-hand circle of 60 m radius at 14 m/s.
fn reference() -> Vec<f64> {
    let row = |t: u32| {
        let angle = 14.0 * 0.05 * f64::from(t) / 60.0;
        [60.0 * angle.sin(), 60.0 * (1.0 - angle.cos()), 14.0, angle]
    };
    (0..=20).flat_map(row).collect()
}

/// The default settings with a horizon of 20 and a window of 10.
fn settings() -> Settings {
    let mut settings = Settings {
        horizon: Some(20),
        ..Settings::default()
    };
    settings.weights.window = Some(10);
    // This exceeds the 0.3 rad at which the simplified vehicle of the tests reaches its largest force, even on friction
    // 0.4.
    settings.soft.slip = Some(1.2);
    settings
}

const X: [f64; 7] = [0.1, -0.5, 13.0, 0.05, 0.02, 0.1, 0.03];

fn whole(c: &mut Criterion, library: &Library, kind: SolverKind) {
    let mut settings = settings();
    settings.solver.kind = kind;
    let mut ws = Workspace::new(library, &settings).unwrap();
    let mut reply = StepReply::default();
    let (reference, widths) = (reference(), [3.0; 42]);
    let (history_z, history_y) = (
        [14.0, 0.1, 0.2, 0.04, 300.0, 0.02].repeat(10),
        [0.01, 0.02, 0.005].repeat(10),
    );
    let cold = StepRequest {
        x: &X,
        u_prev: &[300.0, 0.05],
        history_z: &history_z,
        history_y: &history_y,
        reference: &reference,
        widths: &widths,
        ..StepRequest::default()
    };
    step(library, &settings, &cold, &mut ws, &mut reply).unwrap();
    let carried = reply.clone();
    let warm = StepRequest {
        weights: &carried.weights,
        plan_x: &carried.plan_x,
        plan_u: &carried.plan_u,
        history_f: &carried.history_f[6..],
        ..cold
    };
    for (name, request) in [
        ("cold", cold),
        ("warm", warm),
        (
            "warm with sigma",
            StepRequest {
                want_sigma: true,
                ..warm
            },
        ),
    ] {
        c.bench_function(&format!("step {kind:?}/{name}"), |b| {
            b.iter(|| step(library, &settings, black_box(&request), &mut ws, &mut reply));
        });
    }
}

/// A warm step for 1 to 64 members of 700 points. At most three of them are active, because the measured transitions
/// are exactly their blend.
fn members(c: &mut Criterion) {
    const SHARES: [f64; 3] = [0.5, 0.3, 0.2];
    let settings = settings();
    let reference = reference();
    let spec = libraries::spec(Kernel::Rbf, &[0.4, 0.6, 0.8, 1.0], 700, 3);
    for n in [1, 2, 4, 8, 16, 32, 64] {
        let mut spec = spec.clone();
        let member = |i: usize| egp_core::library::MemberData {
            label: i.to_string(),
            ..spec.members[i % 4].clone()
        };
        spec.members = (0..n).map(member).collect();
        let library = Library::from_bytes(&egp_core::library::encode(&spec).unwrap()).unwrap();
        let mut weights = vec![0.0; n];
        for (i, share) in SHARES.iter().enumerate() {
            weights[i.min(n - 1)] += share;
        }
        let (mut history_z, mut history_y, mut history_f) = (vec![], vec![], vec![]);
        for k in 0..10 {
            let z = [14.0 - 0.1 * f64::from(k), 0.1, 0.2, 0.04, 300.0, 0.02];
            let f: Vec<_> = library
                .members()
                .iter()
                .map(|m| m.mean(&z.into()))
                .collect();
            let y: egp_core::GpOutput = weights.iter().zip(&f).map(|(w, f)| *w * f).sum();
            history_z.extend(z);
            history_y.extend_from_slice(y.as_slice());
            history_f.extend(f.iter().flatten());
        }
        let mut request = StepRequest {
            x: &X,
            u_prev: &[300.0, 0.05],
            weights: &weights,
            history_z: &history_z,
            history_y: &history_y,
            history_f: &history_f[n * 3..], // the newest transition is new
            reference: &reference,
            ..StepRequest::default()
        };
        let mut ws = Workspace::new(&library, &settings).unwrap();
        let mut reply = StepReply::default();
        step(&library, &settings, &request, &mut ws, &mut reply).unwrap();
        let carried = reply.clone();
        let active = carried.weights.iter().filter(|&&w| w > 1e-3).count();
        assert_eq!(active, n.min(3), "{:?}", carried.weights);
        (request.plan_x, request.plan_u) = (&carried.plan_x, &carried.plan_u);
        c.bench_function(&format!("members/{n}"), |b| {
            b.iter(|| {
                step(
                    &library,
                    &settings,
                    black_box(&request),
                    &mut ws,
                    &mut reply,
                )
            });
        });
    }
}

fn phases(c: &mut Criterion, library: &Library) {
    let settings = settings();
    let weights = [0.4, 0.6];
    let ensemble = Ensemble::new(library, &weights);
    let (x0, u_prev) = (
        State::from([0.0, 0.0, 13.0, 0.0, 0.02, 0.1, 0.03]),
        Input::new(300.0, 0.05),
    );
    let (guess, mut dynamics) = (Guess::new(20), Linearisation::new(20));
    let mut linearise = || {
        dynamics.along(
            |_| (ensemble, egp_core::GpOutput::zeros()),
            0.05,
            &x0,
            &guess,
            &settings.operating,
            &Domain::new(&settings.operating, 60.0, library.vehicle()),
        )
    };
    linearise();
    c.bench_function("phase/linearise", |b| b.iter(&mut linearise));

    let targets: Vec<State> = reference()
        .as_chunks::<4>()
        .0
        .iter()
        .map(|r| State::from([r[0], r[1], r[2], r[3], 0.0, 0.0, 0.0]))
        .collect();
    let tyres = TyreLimits {
        friction: 1.0,
        slip: 0.96,
        drive: 6.0,
        brake: 8.0,
        ..TyreLimits::default()
    };
    let road = Road {
        x: &targets,
        widths: &[[3.0; 2]; 21],
        tyres: &[tyres; 21],
    };
    let vehicle = settings.vehicle(library.vehicle());
    let setup = Setup {
        settings: &settings,
        vehicle: &vehicle,
        dt: 0.05,
    };
    let mut qp = OcpQp::new(20, soft_rows(&settings.soft));
    c.bench_function("phase/assemble", |b| {
        b.iter(|| ocp::assemble(&setup, &x0, &u_prev, &dynamics, &guess, &road, &mut qp));
    });

    let mut solver = ClarabelSolver::new(&qp, &settings.solver).unwrap();
    let mut solution = OcpSolution::new(20);
    let mut riccati = RiccatiSolver::new(20, &settings.solver);
    c.bench_function("phase/solve Riccati", |b| {
        b.iter(|| riccati.solve(black_box(&qp), &[], &mut solution))
    });
    c.bench_function("phase/solve Clarabel", |b| {
        b.iter(|| solver.solve(black_box(&qp), &[], &mut solution))
    });
    solve_checked(
        &mut solver,
        &qp,
        &[],
        settings.solver.kkt_tolerance,
        &mut solution,
    );
    c.bench_function("phase/check", |b| b.iter(|| qp.check(&mut solution)));
}

fn weights(c: &mut Criterion, library: &Library) {
    let noise = WindowNoise::of(library, &settings().weights);
    let prior = settings().weights.prior;
    for n in [2, 8, 64] {
        let wave = |i: usize| 0.1 * (i as f64 * 0.7).sin();
        let f: Vec<f64> = (0..10 * n * 3).map(wave).collect();
        let y: Vec<[f64; 3]> = (0..10)
            .map(|k| [wave(k), wave(k + 5), wave(k + 9)])
            .collect();
        let (mut estimator, mut w) = (WeightEstimator::new(n, 10), vec![0.0; n]);
        let mut previous = vec![1.0 / n as f64; n];
        estimator.estimate(&f, &y, &noise, prior, &previous, &mut w);
        previous.clone_from(&w);
        c.bench_function(&format!("phase/weights N={n}"), |b| {
            b.iter(|| estimator.estimate(black_box(&f), &y, &noise, prior, &previous, &mut w));
        });
    }
}

fn all(c: &mut Criterion) {
    let library = libraries::library(Kernel::Rbf, &[0.5, 1.1], 700, 3);
    for kind in SolverKind::ALL {
        whole(c, &library, kind);
    }
    phases(c, &library);
    weights(c, &library);
    members(c);
}

criterion_group! { name = benches; config = Criterion::default().sample_size(50); targets = all }
criterion_main!(benches);
