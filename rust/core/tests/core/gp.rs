//! Gaussian processes against a dense textbook implementation, finite differences and their own bounds.
#![allow(clippy::unwrap_used)]

use egp_core::library::{LibrarySpec, encode};
use egp_core::{GpInput, GpJacobian, Kernel, Library, NY, NZ, VarianceScratch};
use egp_testing::libraries::{CENTRE, HALF_WIDTH, Outputs, spec, spec_of};
use proptest::prelude::*;

/// A library for each kernel, made once. Its members have one kernel for all outputs, three kernels and two kernels.
fn libraries() -> &'static [Library] {
    static LIBRARIES: std::sync::OnceLock<[Library; Kernel::ALL.len()]> =
        std::sync::OnceLock::new();
    LIBRARIES.get_or_init(|| {
        Kernel::ALL.map(|kernel| Library::from_bytes(&encode(&mixed(kernel)).unwrap()).unwrap())
    })
}

fn mixed(kernel: Kernel) -> LibrarySpec {
    let mut one = spec(kernel, &[0.5], 90, 1);
    for (outputs, friction) in [(Outputs::OwnKernels, 0.8), (Outputs::TwoKernels, 1.1)] {
        let more = spec_of(&outputs, kernel, &[friction], 90, 2);
        one.members.extend(more.members);
    }
    one
}

/// GP inputs up to `spread` half widths away from the centre of the data.
fn gp_input(spread: f64) -> impl Strategy<Value = GpInput> {
    prop::array::uniform6(-spread..spread)
        .prop_map(|unit| GpInput::from_fn(|d, _| CENTRE[d] + HALF_WIDTH[d] * unit[d]))
}

proptest! {
    #[test]
    fn variance_is_between_zero_and_prior(z in gp_input(20.0)) {
        for member in libraries().iter().flat_map(Library::members) {
            let variance = member.variance(&z, &mut VarianceScratch::default());
            for o in 0..NY {
                let prior = member.hyperparameters()[o].outputscale * member.target_scaler().std()[o].powi(2);
                prop_assert!((0.0..=prior * (1.0 + 1e-15)).contains(&variance[o]));
            }
        }
    }

    #[test]
    fn jacobian_is_the_slope_of_the_mean(z in gp_input(1.5)) {
        for member in libraries().iter().flat_map(Library::members) {
            let mut jacobian = GpJacobian::zeros();
            let mean = member.mean_jacobian(&z, &mut jacobian);
            prop_assert!((mean - member.mean(&z)).amax() < 1e-14);
            for d in 0..NZ {
                // Central differences: truncation ~ step², rounding ~ 1e-16 alpha / step.
                let step = 1e-5 * HALF_WIDTH[d];
                let mut offset = GpInput::zeros();
                offset[d] = step;
                let slope = (member.mean(&(z + offset)) - member.mean(&(z - offset))) / (2.0 * step);
                prop_assert!((slope - jacobian.column(d)).amax() * HALF_WIDTH[d] < 1e-7);
            }
        }
    }
}

#[test]
fn at_training_points_variance_is_below_noise_and_the_jacobian_finite() {
    for library in libraries() {
        let data = mixed(library.kernel()).members;
        let pairs = data.into_iter().zip(library.members());
        for (z, member) in
            pairs.flat_map(|(data, member)| data.inputs.into_iter().map(move |z| (z, member)))
        {
            let z = GpInput::from(z);
            let variance = member.variance(&z, &mut VarianceScratch::default());
            let noise = member.noise_std().map(|std| std * std);
            assert!(
                variance
                    .iter()
                    .zip(noise.iter())
                    .all(|(variance, noise)| variance < noise)
            );
            let mut jacobian = GpJacobian::zeros();
            member.mean_jacobian(&z, &mut jacobian);
            assert!(jacobian.iter().all(|entry| entry.is_finite()));
        }
    }
}

#[test]
fn far_from_the_data_the_prior_remains() {
    for member in libraries().iter().flat_map(Library::members) {
        let z = GpInput::from_fn(|d, _| CENTRE[d] + 1e3 * HALF_WIDTH[d]);
        let mut jacobian = GpJacobian::repeat(f64::NAN);
        let mean = member.mean_jacobian(&z, &mut jacobian);
        let prior = nalgebra::SVector::from_fn(|o, _| member.hyperparameters()[o].constant);
        assert_eq!(mean, member.target_scaler().unscale(&prior));
        assert_eq!(jacobian, GpJacobian::zeros());
    }
}
