//! What a vehicle computes in a control period beside its step: belief about the road, plan of the speed, preview.
//!
//! Run `cargo bench -p egp-bench --bench planning`. The goal for the plan alone is at most 50 µs.
#![allow(missing_docs)]

use criterion::{Criterion, criterion_group, criterion_main};
use egp_testing::planning::Planning;

/// Stages of the control step, for which the preview is made.
const HORIZON: usize = 40;

fn all(c: &mut Criterion) {
    for (reports, name) in [(false, "own evidence"), (true, "with reports")] {
        let mut planning = Planning::new(HORIZON, reports);
        let mut part = |name: &str, run: fn(&mut Planning)| {
            c.bench_function(name, |b| b.iter(|| run(&mut planning)));
        };
        part(&format!("{name}/update"), Planning::update);
        part(&format!("{name}/ahead"), |planning| {
            planning.ahead();
        });
        part(&format!("{name}/preview"), |planning| {
            planning.preview();
        });
        part(&format!("{name}/plan"), |planning| {
            planning.plan();
        });
        part(&format!("{name}/period"), |planning| {
            planning.period();
        });
    }
}

criterion_group!(benches, all);
criterion_main!(benches);
