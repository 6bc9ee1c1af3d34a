//! Powers of two of a block of numbers that are not positive.

use crate::simd::Simd;

/// `2^x` for `x <= 0` (and for the rounding errors above it), to 5e-16; below -1022.5 it is 0, and NaN stays NaN.
///
/// `x = n + f`, `|f| <= 1/2`: exact, unlike the range reduction of `exp`, which is why kernels scale their exponents
/// to base 2. `2^f` by its polynomial of degree 10 through the Chebyshev nodes, relative error 3.2e-16. No branch and
/// no table.
#[inline(always)]
pub(super) fn exp2<S: Simd>(simd: S, x: S::V) -> S::V {
    /// Adding this rounds to an integer and leaves it in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²
    /// The exponent bits of `2^n` are then zero, and with them the number.
    const LOWEST: f64 = -1023.0;
    let clamped = simd.max(simd.splat(LOWEST), x);
    let shifted = simd.add(clamped, simd.splat(ROUND));
    let f = simd.sub(clamped, simd.sub(shifted, simd.splat(ROUND)));
    let mut p = simd.splat(COEFFICIENTS[0]);
    for c in &COEFFICIENTS[1..] {
        p = simd.mul_add(p, f, simd.splat(*c));
    }
    simd.mul(p, simd.power_of_two(shifted))
}

/// Of `2^f`, highest power first: interpolation at the 11 Chebyshev nodes of [-1/2, 1/2] in 60 digits.
const COEFFICIENTS: [f64; 11] = [
    7.072_585_949_269_223e-9,
    1.020_869_029_995_830_6e-7,
    1.321_544_258_792_169e-6,
    1.525_265_726_020_083_7e-5,
    1.540_353_044_173_605e-4,
    1.333_355_823_016_497_4e-3,
    9.618_129_107_606_888e-3,
    5.550_410_866_444_772e-2,
    2.402_265_069_591_009_7e-1,
    6.931_471_805_599_5e-1,
    1.0,
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::{Wide, wide};

    struct All<'a>(&'a [f64]);

    impl Wide for All<'_> {
        type Output = Vec<f64>;

        #[inline(always)]
        fn compute<S: Simd>(self, simd: S) -> Vec<f64> {
            let (blocks, _) = self.0.as_chunks();
            let exp2 = |x| simd.store(exp2(simd, simd.load(x)));
            blocks.iter().flat_map(exp2).collect()
        }
    }

    #[test]
    fn agrees_with_the_standard_library() {
        let x: Vec<f64> = (0..200_000)
            .map(|i| 1e-12 - 1022.0 * (f64::from(i) / 200_000.0).powi(3))
            .collect();
        for (x, got) in x.iter().zip(wide(All(&x))) {
            let want = x.exp2();
            let error = (got / want - 1.0).abs();
            assert!(error < 1e-15, "exp2({x}) = {got:e}, not {want:e}");
        }
    }

    #[test]
    fn at_the_ends() {
        let x = [
            0.0,
            -1.0,
            -1023.0,
            -1e6,
            f64::NEG_INFINITY,
            -1022.6,
            -2.0,
            f64::NAN,
        ];
        let got = wide(All(&x));
        assert_eq!(got[..7], [1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.25]);
        assert!(got[7].is_nan());
    }
}
