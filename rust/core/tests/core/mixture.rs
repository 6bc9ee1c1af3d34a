//! The variance of an ensemble by its definition, as the reference of bounds.

use egp_core::{GpInput, GpOutput, Member, VarianceScratch};

/// `Σ w (σ² + s²) + Σ w (μ - μ̄)²` with the members' means `μ`, variances `σ²` and noise `s`.
pub fn variance(members: &[Member], weights: &[f64], z: &GpInput) -> GpOutput {
    let pairs = || members.iter().zip(weights);
    let sum = |term: &dyn Fn(&Member) -> GpOutput| -> GpOutput {
        pairs().map(|(member, weight)| term(member) * *weight).sum()
    };
    let square = |v: GpOutput| v.component_mul(&v);
    let mean = sum(&|member| member.mean(z));
    sum(&|member| {
        let latent = member.variance(z, &mut VarianceScratch::default());
        latent + square(member.noise_std()) + square(member.mean(z) - mean)
    })
}
