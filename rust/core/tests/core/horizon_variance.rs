//! Bounds of the variance along a horizon against the exact variance, on the shipped library and on sampled ones.
#![allow(clippy::unwrap_used)]

use egp_core::library::encode;
use egp_core::{Ensemble, GpInput, GpOutput, Kernel, Library, MixtureScratch, NY, NZ, Sequential};
use egp_testing::libraries::{self, Outputs, spec_of};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::mixture::variance;

/// The relative excess that [`Ensemble::mixture_bounds`] allows.
const TOLERANCE: f64 = 0.1;

fn demo() -> Library {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../python/egp_service/shipped/demo-library.safetensors"
    );
    Library::from_bytes(&std::fs::read(path).unwrap()).unwrap()
}

/// Twenty GP inputs along a smooth curve inside a member's envelope, about as long as a second of driving.
fn curve(library: &Library, rng: &mut ChaCha8Rng) -> Vec<GpInput> {
    let (min, max) = library.members()[0].envelope();
    let range = max - min;
    let unit = |rng: &mut ChaCha8Rng| GpInput::from_fn(|_, _| rng.random_range(0.2..0.8));
    let start = min + unit(rng).component_mul(&range);
    let (slope, bend) = (unit(rng).add_scalar(-0.5), unit(rng).add_scalar(-0.5));
    let reach = GpInput::from([0.2, 0.4, 0.6, 0.6, 0.8, 0.8]);
    let point = |t: i32| {
        let s = f64::from(t) / 20.0;
        start
            + (slope * s + bend * s * s)
                .component_mul(&reach)
                .component_mul(&range)
    };
    (0..20).map(point).collect()
}

/// Checks curves; returns the largest relative excess.
fn check(library: &Library, curves: u32) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut horizon = MixtureScratch::default();
    let mut worst = 0.0_f64;
    for i in 0..curves {
        let share = rng.random_range(0.0..=1.0);
        // Every third case has one active member, whose bound contains no disagreement.
        let weights = if i % 3 == 0 {
            [1.0, 0.0]
        } else {
            [share, 1.0 - share]
        };
        let ensemble = Ensemble::new(library, &weights);
        let z = curve(library, &mut rng);
        let mut bounds = [GpOutput::zeros(); 20];
        Ensemble::mixture_bounds(|_| ensemble, &z, &mut horizon, &mut bounds, &Sequential);
        for (z, bound) in z.iter().zip(&bounds) {
            let exact = variance(library.members(), &weights, z);
            for o in 0..NY {
                let excess = bound[o] / exact[o] - 1.0;
                assert!(excess > -1e-8, "{excess:e} below the exact variance");
                assert!(excess < TOLERANCE, "{excess} above the exact variance");
                worst = worst.max(excess);
            }
        }
    }
    worst
}

#[test]
fn on_the_shipped_library() {
    let worst = check(&demo(), 40);
    assert!(worst > 1e-6, "all stages were nodes: {worst:e}");
}

#[test]
fn on_sampled_libraries() {
    for kernel in Kernel::ALL {
        for outputs in [Outputs::OneKernel, Outputs::OwnKernels] {
            let spec = spec_of(&outputs, kernel, &[0.5, 1.1], 250, 3);
            check(&Library::from_bytes(&encode(&spec).unwrap()).unwrap(), 20);
        }
    }
}

#[test]
fn at_training_points_and_far_from_all() {
    let spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 120, 1);
    let library = libraries::library(Kernel::Rbf, &[0.5, 1.1], 120, 1);
    let weights = [0.4, 0.6];
    let ensemble = Ensemble::new(&library, &weights);
    let mut horizon = MixtureScratch::default();
    // Repeated stages have a singular prior covariance.
    let mut z: Vec<GpInput> = spec.members[0].inputs[..9]
        .iter()
        .map(|z| (*z).into())
        .collect();
    z.push(z[3]);
    z.push(z[3] + GpInput::repeat(1e-9));
    z.push(GpInput::from([1e6; NZ]));
    let mut bounds = vec![GpOutput::zeros(); z.len()];
    Ensemble::mixture_bounds(|_| ensemble, &z, &mut horizon, &mut bounds, &Sequential);
    for (z, bound) in z.iter().zip(&bounds) {
        let exact = variance(library.members(), &weights, z);
        for o in 0..NY {
            let excess = bound[o] / exact[o] - 1.0;
            assert!((-1e-8..TOLERANCE).contains(&excess), "{excess:e}");
        }
    }
}

#[test]
fn the_bits_do_not_depend_on_earlier_contents_of_the_memory() {
    let library = demo();
    let ensemble = Ensemble::new(&library, &[0.4, 0.6]);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (first, second) = (curve(&library, &mut rng), curve(&library, &mut rng));
    let bounds = |z: &[GpInput], scratch: &mut MixtureScratch| {
        let mut out = vec![GpOutput::zeros(); z.len()];
        Ensemble::mixture_bounds(|_| ensemble, z, scratch, &mut out, &Sequential);
        out
    };
    let fresh = bounds(&second, &mut MixtureScratch::default());
    let mut used = MixtureScratch::default();
    bounds(&first, &mut used);
    bounds(&first[..5], &mut used);
    assert_eq!(bounds(&second, &mut used), fresh);
}
