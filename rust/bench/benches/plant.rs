//! Speed of the plant on one core relative to real time.
//!
//! `real_time_factor` drives one second, 20 periods of 50 ms, in each iteration: the time shown, in seconds, is the
//! inverse of the real-time factor (2 ms is 500 times real time).

#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use egp_plant::{Plant, Surface, Uniform, VehicleId, VehicleState, derivative};

fn right_hand_side(c: &mut Criterion) {
    let parameters = VehicleId::FordEscort.parameters();
    let plant = cornering(15.0);
    c.bench_function("derivative", |b| {
        b.iter(|| {
            derivative(
                &parameters,
                black_box(plant.state()),
                [500.0, 0.1],
                &[Surface::from(0.8); 4],
            )
            .unwrap()
        });
    });
}

fn real_time_factor(c: &mut Criterion) {
    let surface = Uniform::new(0.8).unwrap();
    let mut group = c.benchmark_group("one_second");
    for speed in [5.0, 10.0, 15.0, 25.0] {
        let start = cornering(speed);
        group.bench_with_input(BenchmarkId::from_parameter(speed), &start, |b, start| {
            b.iter(|| {
                let mut plant = start.clone();
                for period in 0..20 {
                    let rate = if period < 10 { 0.02 } else { -0.02 };
                    plant.step([300.0, rate], 0.05, &surface).unwrap();
                }
                plant.vehicle_state()
            });
        });
    }
    group.finish();
}

/// A plant at `speed` in a gentle bend.
fn cornering(speed: f64) -> Plant {
    let mut plant = Plant::new(VehicleId::FordEscort.parameters());
    plant
        .reset(&VehicleState {
            v_x: speed,
            omega: 0.1,
            delta: 0.02,
            ..VehicleState::default()
        })
        .unwrap();
    plant
}

criterion_group!(benches, right_hand_side, real_time_factor);
criterion_main!(benches);
