//! Inverse tangent, sine and cosine of eight numbers.
//!
//! The functions have no branch and no lookup in memory that depends on the argument. Their polynomials interpolate at
//! Chebyshev nodes and were computed with 60 digits. The largest errors, measured against the standard library, are below 2
//! units in the last place, for sine and cosine of arguments up to 1e9.

use std::f64::consts::{FRAC_2_PI, FRAC_PI_2, FRAC_PI_4};

use super::Simd;

/// The inverse tangent, NaN for NaN.
///
/// The argument is reduced to at most `tan(pi/8)` by `atan(x) = pi/4 + atan((x - 1) / (x + 1))` and, beyond
/// `tan(3 pi/8)`, by `atan(x) = pi/2 + atan(-1 / x)`.
#[inline(always)]
pub(crate) fn atan<S: Simd>(simd: S, x: S::V) -> S::V {
    /// `tan(pi/8)` and `tan(3 pi/8)`.
    const ENDS: [f64; 2] = [0.414_213_562_373_095_05, 2.414_213_562_373_095];
    let [zero, one] = [0.0, 1.0].map(|c| simd.splat(c));
    let size = simd.max(x, simd.sub(zero, x));
    let [small, large] = ENDS.map(|end| simd.splat(end));
    // In each lane `high` for sizes above the second one of `ENDS`, `middle` above the first one, and `low` otherwise.
    let pick = |low, middle, high| {
        let middle = simd.where_greater(size, small, middle, low);
        simd.where_greater(size, large, high, middle)
    };
    let above = pick(size, simd.sub(size, one), simd.splat(-1.0));
    let below = pick(one, simd.add(size, one), size);
    let angle = pick(zero, simd.splat(FRAC_PI_4), simd.splat(FRAC_PI_2));
    let r = simd.div(above, below);
    let square = simd.mul(r, r);
    let p = polynomial(simd, &ATAN, square);
    let result = simd.add(angle, simd.mul_add(simd.mul(r, square), p, r));
    simd.where_greater(zero, x, simd.sub(zero, result), result)
}

/// Sine and cosine of numbers up to 1e15, NaN for NaN. Larger numbers are taken as 1e15.
///
/// The argument is reduced to at most `pi/4` by subtracting the nearest multiple of `pi/2`, which is represented by
/// two numbers.
#[inline(always)]
pub(crate) fn sin_cos<S: Simd>(simd: S, x: S::V) -> (S::V, S::V) {
    /// What `FRAC_PI_2` lacks of pi/2.
    const REST: f64 = 6.123_233_995_736_766e-17;
    const LARGEST: f64 = 1e15;
    /// Adding and subtracting this number rounds to integers.
    const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²
    let splat = |c| simd.splat(c);
    let [zero, one] = [0.0, 1.0].map(splat);
    let negated = |x| simd.sub(zero, x);
    let round = |x| simd.sub(simd.add(x, splat(ROUND)), splat(ROUND));
    let least = splat(-LARGEST);
    let x = negated(simd.max(least, negated(simd.max(least, x))));

    let quarters = round(simd.mul(x, splat(FRAC_2_PI)));
    let r = simd.mul_add(quarters, splat(-FRAC_PI_2), x);
    let r = simd.mul_add(quarters, splat(-REST), r);
    let square = simd.mul(r, r);
    let sine = simd.mul_add(simd.mul(r, square), polynomial(simd, &SINE, square), r);
    let p = polynomial(simd, &COSINE, square);
    let tail = simd.mul_add(simd.mul(square, square), p, simd.mul(square, splat(-0.5)));
    let cosine = simd.add(one, tail);

    // The remainder of `quarters` after division by 4: 0, 1, 2 or 3.
    let turns = round(simd.mul_add(quarters, splat(0.25), splat(-0.375)));
    let quarter = simd.mul_add(turns, splat(-4.0), quarters);
    let halves = round(simd.mul_add(quarter, splat(0.5), splat(-0.25)));
    let odd = simd.mul_add(halves, splat(-2.0), quarter);
    let from_middle = simd.sub(quarter, splat(1.5));
    let from_middle = simd.max(from_middle, negated(from_middle));
    let sin = simd.where_greater(odd, splat(0.5), cosine, sine);
    let cos = simd.where_greater(odd, splat(0.5), sine, cosine);
    (
        simd.where_greater(quarter, splat(1.5), negated(sin), sin),
        simd.where_greater(one, from_middle, negated(cos), cos),
    )
}

/// `c₀ xⁿ + c₁ xⁿ⁻¹ + ... + cₙ`.
#[inline(always)]
fn polynomial<S: Simd>(simd: S, coefficients: &[f64], x: S::V) -> S::V {
    let mut sum = simd.splat(coefficients[0]);
    for c in &coefficients[1..] {
        sum = simd.mul_add(sum, x, simd.splat(*c));
    }
    sum
}

/// Coefficients of `(atan(r) - r) / r³` as a polynomial in `r²`, highest power first, for `|r| <= tan(pi/8)`. The relative
/// error of `atan` is 7e-18 before rounding.
const ATAN: [f64; 11] = [
    -0.019_176_887_119_062_26,
    0.039_231_658_295_587_19,
    -0.050_854_497_379_402_6,
    0.058_581_489_128_022_1,
    -0.066_645_114_473_819_48,
    0.076_921_831_908_260_87,
    -0.090_909_045_781_239_03,
    0.111_111_110_152_563_61,
    -0.142_857_142_846_665_42,
    0.199_999_999_999_955_2,
    -0.333_333_333_333_333_3,
];

/// Coefficients of `(sin(r) - r) / r³` as a polynomial in `r²`, for `|r| <= pi/4`; relative error of `sin` 2e-17.
const SINE: [f64; 6] = [
    1.591_812_929_486_660_8e-10,
    -2.505_113_184_500_362_4e-8,
    2.755_731_610_255_244e-6,
    -0.000_198_412_698_367_585_74,
    0.008_333_333_333_330_948,
    -0.166_666_666_666_666_66,
];

/// Coefficients of `(cos(r) - 1 + r²/2) / r⁴` as a polynomial in `r²`, for `|r| <= pi/4`; relative error of `cos` 1e-18.
const COSINE: [f64; 6] = [
    -1.138_263_242_552_171_7e-11,
    2.087_614_626_840_32e-9,
    -2.755_731_727_172_979_3e-7,
    2.480_158_729_876_569e-5,
    -0.001_388_888_888_888_739_8,
    0.041_666_666_666_666_664,
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{LANES, Lanes};
    use crate::simd::{Wide, with_each};

    /// Inverse tangent, sine and cosine of all numbers.
    #[derive(Clone, Copy)]
    struct All<'a>(&'a [Lanes]);

    impl Wide for All<'_> {
        type Output = Vec<[Lanes; 3]>;

        #[inline(always)]
        fn compute<S: Simd>(self, simd: S) -> Vec<[Lanes; 3]> {
            let all = |x: &Lanes| {
                let x = simd.load(x);
                let (sin, cos) = sin_cos(simd, x);
                [atan(simd, x), sin, cos].map(|y| simd.store(y))
            };
            self.0.iter().map(all).collect()
        }
    }

    /// Inputs with their results, which are the same bits with every instruction set of this machine.
    fn results(x: impl Iterator<Item = f64>) -> Vec<(f64, [f64; 3])> {
        let x: Vec<f64> = x.collect();
        let blocks: Vec<Lanes> = x.as_chunks().0.to_vec();
        let results = with_each(All(&blocks));
        let bits = |y: &[[Lanes; 3]]| -> Vec<u64> {
            y.iter().flatten().flatten().map(|y| y.to_bits()).collect()
        };
        for result in &results {
            assert_eq!(bits(result), bits(&results[0]));
        }
        let lanes = results[0]
            .iter()
            .flat_map(|y| (0..LANES).map(|l| y.map(|y| y[l])));
        x.into_iter().zip(lanes).collect()
    }

    /// Difference in units in the last place of `want`, or of 1e-16 if that is smaller.
    fn units(got: f64, want: f64) -> f64 {
        (got - want).abs() / (want.abs() * f64::EPSILON).max(1e-32)
    }

    #[test]
    fn agree_with_the_standard_library() {
        let spread = |i: u32| {
            let share = f64::from(i) / 80_000.0 - 1.0;
            [4.0 * share, 1e3 * share.powi(3), 1e-3 * share, 1e9 * share]
        };
        for (x, [tangent, sin, cos]) in results((0..160_000).flat_map(spread)) {
            for (got, want) in [(tangent, x.atan()), (sin, x.sin()), (cos, x.cos())] {
                assert!(units(got, want) < 2.0, "{x}: {got:e}, not {want:e}");
            }
        }
    }

    #[test]
    fn limits_and_nan() {
        let [infinity, nan] = [f64::INFINITY, f64::NAN];
        let x = [0.0, infinity, -infinity, 1e300, -1e300, nan, 1e-300, 1e15];
        let got = results(x.into_iter());
        let tangents = [0.0, FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2];
        assert_eq!(std::array::from_fn(|i| got[i].1[0]), tangents);
        assert!(got[5].1.iter().all(|y| y.is_nan()));
        assert_eq!(got[6].1, [1e-300, 1e-300, 1.0]);
        for (_, [_, sin, cos]) in got.iter().filter(|(x, _)| !x.is_nan()) {
            assert!((sin * sin + cos * cos - 1.0).abs() < 1e-15);
        }
    }
}
