//! One GP query of one member (all three outputs): mean, mean with Jacobian, variance.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::semicolon_if_nothing_returned
)]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use egp_core::library::encode;
use egp_core::{GpInput, GpJacobian, Kernel, Library, VarianceScratch};
use egp_testing::libraries::{self, Outputs};

fn queries(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("gp");
    for (outputs, kernel, n) in [
        (Outputs::OneKernel, Kernel::Rbf, 700),
        (Outputs::OneKernel, Kernel::Matern52, 700),
        (Outputs::OneKernel, Kernel::Rbf, 2000),
        (Outputs::OwnKernels, Kernel::Rbf, 700),
    ] {
        let spec = libraries::spec_of(&outputs, kernel, &[0.8], n, 0);
        let library = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
        let member = &library.members()[0];
        let z = GpInput::from(libraries::CENTRE).add_scalar(0.1);
        let own = match outputs {
            Outputs::OneKernel => "",
            _ => " own kernels",
        };
        let name = |what| BenchmarkId::new(what, format!("{} {n}{own}", kernel.name()));
        group.bench_function(name("mean"), |bencher| {
            bencher.iter(|| member.mean(black_box(&z)))
        });
        let mut jacobian = GpJacobian::zeros();
        group.bench_function(name("mean_jacobian"), |bencher| {
            bencher.iter(|| member.mean_jacobian(black_box(&z), &mut jacobian));
        });
        let mut scratch = VarianceScratch::default();
        group.bench_function(name("variance"), |bencher| {
            bencher.iter(|| member.variance(black_box(&z), &mut scratch));
        });
    }
    group.finish();
}

fn load(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("library");
    group.sample_size(10);
    for n in [700, 2000] {
        let bytes = encode(&libraries::spec(Kernel::Rbf, &[0.8], n, 0)).unwrap();
        group.bench_function(BenchmarkId::new("load one member", n), |bencher| {
            bencher.iter(|| Library::from_bytes(black_box(&bytes)));
        });
    }
    group.finish();
}

criterion_group!(benches, queries, load);
criterion_main!(benches);
