//! Z-score scaling between physical units and the z-scored space of the GPs.

use nalgebra::SVector;

/// `scaled = (physical - mean) / std`, for each of the `D` dimensions.
#[derive(Clone, Debug)]
pub struct Scaler<const D: usize> {
    mean: SVector<f64, D>,
    std: SVector<f64, D>,
}

impl<const D: usize> Scaler<D> {
    /// A scaler from means and (positive) standard deviations in physical units.
    pub fn new(mean: [f64; D], std: [f64; D]) -> Self {
        Self {
            mean: mean.into(),
            std: std.into(),
        }
    }

    /// The scaled value of a physical one.
    // Division instead of multiplication by a reciprocal gives the same bits as numpy in training.
    pub fn scale(&self, physical: &SVector<f64, D>) -> SVector<f64, D> {
        (physical - self.mean).component_div(&self.std)
    }

    /// The physical value of a scaled one.
    pub fn unscale(&self, scaled: &SVector<f64, D>) -> SVector<f64, D> {
        self.mean + scaled.component_mul(&self.std)
    }

    /// Standard deviations in physical units: the size of one scaled unit.
    pub fn std(&self) -> &SVector<f64, D> {
        &self.std
    }
}
