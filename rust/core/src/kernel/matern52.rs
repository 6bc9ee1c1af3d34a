//! Matérn kernel with ν = 5/2.

use std::f64::consts::LOG2_E;

use super::Profile;
use super::exp::exp2;
use crate::simd::Simd;

/// `φ(r²) = (1 + a + a²/3) exp(-a)`, `a = √t`, `t = 5 r²`; Rasmussen & Williams (2006), eq. (4.17).
///
/// The slope `dφ/d(r²) = -5/6 (1 + a) exp(-a)` needs no division by `r`.
#[derive(Debug)]
pub(crate) struct Matern52;

impl Profile for Matern52 {
    const SCALE: f64 = 5.0;
    const SLOPE: f64 = -5.0 / 6.0;
    const SLOPE_IS_VALUE: bool = false;

    #[inline(always)]
    fn value<S: Simd>(simd: S, t: S::V) -> S::V {
        Self::value_slope(simd, t).0
    }

    #[inline(always)]
    fn value_slope<S: Simd>(simd: S, t: S::V) -> (S::V, S::V) {
        // Rounding may give a tiny negative number where points coincide.
        let t = simd.max(simd.splat(0.0), t);
        let a = simd.sqrt(t);
        let decay = exp2(simd, simd.mul(simd.splat(-LOG2_E), a));
        let slope = simd.mul_add(decay, a, decay);
        let third = simd.mul(simd.splat(1.0 / 3.0), t);
        (simd.mul_add(third, decay, slope), slope)
    }
}
