//! Squared-exponential kernel.

use std::f64::consts::LOG2_E;

use super::Profile;
use super::exp::exp2;
use crate::simd::Simd;

/// `φ(r²) = exp(-r²/2) = 2^t`, `t = -log₂(e)/2 r²`; Rasmussen & Williams (2006), eq. (4.9).
#[derive(Debug)]
pub(crate) struct Rbf;

impl Profile for Rbf {
    const SCALE: f64 = -0.5 * LOG2_E;
    const SLOPE: f64 = -0.5;
    const SLOPE_IS_VALUE: bool = true;

    #[inline(always)]
    fn value<S: Simd>(simd: S, t: S::V) -> S::V {
        exp2(simd, t)
    }

    #[inline(always)]
    fn value_slope<S: Simd>(simd: S, t: S::V) -> (S::V, S::V) {
        let value = exp2(simd, t);
        (value, value)
    }
}
