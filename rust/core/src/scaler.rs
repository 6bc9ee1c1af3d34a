//! Z-score scaling between physical units and the space the GPs live in.

use nalgebra::SVector;

/// `scaled = (physical - mean) / std`, each of the `D` dimensions by itself.
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
    // Divides rather than multiplies by a reciprocal, so that training code in numpy gets the same bits.
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
