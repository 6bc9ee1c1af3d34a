//! `2^x` for a block of non-positive numbers.

use super::Lanes;
use crate::simd::Simd;

/// `2^x` for `x <= 0` (and for rounding errors above 0) with relative error 2e-15. The result is below 2^-1022 for
/// `x <= -1022`, 0 for `x <= -1023`, and NaN for NaN.
///
/// The range reduction `x = k/8 + f`, `|f| <= 1/16`, is exact, unlike that of `exp`; kernels therefore scale their
/// exponents to base 2. `2^(k/8)` comes from a table of eight and integer arithmetic. `2^f` is a polynomial of degree 6
/// through the Chebyshev nodes with relative error 9.3e-16. The function has no branch, and the instruction
/// sets with vectors keep the table in registers.
#[inline(always)]
pub(super) fn exp2<S: Simd>(simd: S, x: S::V) -> S::V {
    /// Adding this number rounds `x` to eighths and leaves `k` in the low bits.
    const ROUND: f64 = 844_424_930_131_968.0; // 1.5 · 2⁴⁹
    /// The exponent bits of `2^(k/8)` are zero here, and so is the number.
    const LOWEST: f64 = -1023.0;
    let clamped = simd.max(simd.splat(LOWEST), x);
    let shifted = simd.add(clamped, simd.splat(ROUND));
    let f = simd.sub(clamped, simd.sub(shifted, simd.splat(ROUND)));
    let mut p = simd.splat(COEFFICIENTS[0]);
    for c in &COEFFICIENTS[1..] {
        p = simd.mul_add(p, f, simd.splat(*c));
    }
    simd.mul(p, simd.add_exponent(simd.load(&EIGHTHS), shifted))
}

/// Coefficients of `2^f`, highest power first: interpolation at the 7 Chebyshev nodes of [-1/16, 1/16], computed with
/// 60 digits.
const COEFFICIENTS: [f64; 7] = [
    1.540_443_381_934_758_2e-4,
    1.333_460_084_775_199_5e-3,
    9.618_129_089_983_302e-3,
    5.550_410_846_116_699e-2,
    2.402_265_069_591_093_3e-1,
    6.931_471_805_600_448e-1,
    1.0,
];

/// `2^(k/8)` for `k` in `0..8`, less the bits that [`Simd::add_exponent`] adds for `k`.
const EIGHTHS: Lanes = {
    let mut powers = [
        1.0,
        1.090_507_732_665_257_7,
        1.189_207_115_002_721,
        1.296_839_554_651_009_6,
        std::f64::consts::SQRT_2,
        1.542_210_825_407_940_7,
        1.681_792_830_507_429,
        1.834_008_086_409_342_4,
    ];
    let mut k = 0;
    while k < powers.len() {
        powers[k] = f64::from_bits(powers[k].to_bits() - ((k as u64) << 49));
        k += 1;
    }
    powers
};

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
            assert!(error < 1.5e-15, "exp2({x}) = {got:e}, not {want:e}");
        }
    }

    #[test]
    fn limits_and_nan() {
        let x = [
            0.0,
            -1.0,
            -1023.0,
            -1e6,
            f64::NEG_INFINITY,
            -1023.1,
            -2.0,
            f64::NAN,
        ];
        let got = wide(All(&x));
        assert_eq!(got[..7], [1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.25]);
        assert!(got[7].is_nan());
    }
}
