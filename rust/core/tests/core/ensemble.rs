//! The blend of members: mean, Jacobian and variances.
#![allow(clippy::unwrap_used)]

use std::sync::OnceLock;

use egp_core::{
    Ensemble, GpInput, GpJacobian, GpOutput, Kernel, Library, MixtureScratch, NY, Sequential,
    VarianceScratch,
};
use egp_testing::libraries::{self, CENTRE, HALF_WIDTH};
use proptest::prelude::*;

use crate::mixture::variance;

const MEMBERS: usize = 3;

fn library() -> &'static Library {
    static LIBRARY: OnceLock<Library> = OnceLock::new();
    LIBRARY.get_or_init(|| libraries::library(Kernel::Matern52, &[0.4, 0.7, 1.1], 60, 5))
}

fn gp_input() -> impl Strategy<Value = GpInput> {
    prop::array::uniform6(-2.0..2.0)
        .prop_map(|unit| GpInput::from_fn(|d, _| CENTRE[d] + HALF_WIDTH[d] * unit[d]))
}

/// Points of the simplex.
fn weights() -> impl Strategy<Value = Vec<f64>> {
    prop::array::uniform3(1e-3..1.0_f64).prop_map(|w| w.map(|x| x / w.iter().sum::<f64>()).to_vec())
}

/// The variance of member `n` with its noise.
fn noisy_variance(n: usize, z: &GpInput) -> GpOutput {
    let member = &library().members()[n];
    let noise = member.noise_std().map(|std| std * std);
    member.variance(z, &mut VarianceScratch::default()) + noise
}

proptest! {
    #[test]
    fn one_hot_weights_give_the_member(z in gp_input(), n in 0..MEMBERS) {
        let mut one_hot = vec![0.0; MEMBERS];
        one_hot[n] = 1.0;
        let ensemble = Ensemble::new(library(), &one_hot);
        let member = &library().members()[n];
        let (mut blended, mut own) = (GpJacobian::zeros(), GpJacobian::zeros());
        prop_assert_eq!(ensemble.tangent(&z, &mut blended), member.mean_jacobian(&z, &mut own));
        prop_assert_eq!(blended, own);
        prop_assert_eq!(ensemble.mean(&z), member.mean(&z));
        prop_assert_eq!(variance(library().members(), &one_hot, &z), noisy_variance(n, &z));
    }

    #[test]
    fn the_mean_stays_between_the_members(z in gp_input(), w in weights()) {
        let mean = Ensemble::new(library(), &w).mean(&z);
        for o in 0..NY {
            let means = library().members().iter().map(|member| member.mean(&z)[o]);
            let (min, max) = means.fold((f64::MAX, f64::MIN), |(min, max), m| (min.min(m), max.max(m)));
            prop_assert!((min - 1e-14..=max + 1e-14).contains(&mean[o]));
        }
    }

    #[test]
    fn the_jacobian_is_the_slope_of_the_mean(z in gp_input(), w in weights()) {
        let ensemble = Ensemble::new(library(), &w);
        let mut jacobian = GpJacobian::zeros();
        ensemble.tangent(&z, &mut jacobian);
        let direction = GpInput::from(HALF_WIDTH) * 1e-5;
        let slope = (ensemble.mean(&(z + direction)) - ensemble.mean(&(z - direction))) / 2.0;
        // The step is 1e-5 half widths: truncation ~ 1e-15, rounding ~ 1e-15.
        prop_assert!((slope - jacobian * direction).amax() < 1e-12);
    }

    #[test]
    fn the_bound_contains_the_members_variances_and_their_disagreement(z in gp_input(), w in weights()) {
        let ensemble = Ensemble::new(library(), &w);
        let mut bound = [GpOutput::zeros()];
        let mut scratch = MixtureScratch::default();
        Ensemble::mixture_bounds(|_| ensemble, &[z], &mut scratch, &mut bound, &Sequential);
        let (exact, mean) = (variance(library().members(), &w, &z), ensemble.mean(&z));
        for o in 0..NY {
            let weighted: f64 = (0..MEMBERS).map(|n| w[n] * noisy_variance(n, &z)[o]).sum();
            let squares = |n: usize| w[n] * (library().members()[n].mean(&z)[o] - mean[o]).powi(2);
            let disagreement: f64 = (0..MEMBERS).map(squares).sum();
            prop_assert!((exact[o] - weighted - disagreement).abs() < 1e-12 * exact[o]);
            prop_assert!((exact[o] * (1.0 - 1e-12)..=exact[o] * 1.22).contains(&bound[0][o]));
        }
    }

    #[test]
    fn a_member_without_weight_is_not_active(z in gp_input(), share in 0.01..0.99) {
        let w = [share, 0.0, 1.0 - share];
        let ensemble = Ensemble::new(library(), &w);
        let labels: Vec<_> = ensemble.active().map(|(_, member)| member.label()).collect();
        prop_assert_eq!(labels, ["friction 0.4", "friction 1.1"]);
        prop_assert!(ensemble.active().map(|(weight, _)| weight).eq([share, 1.0 - share]));
        prop_assert!(ensemble.mean(&z).iter().all(|mean| mean.is_finite()));
    }
}
