//! Vector instructions: the only folder of this crate with `unsafe`.
//!
//! The features are detected at run time, so one binary serves every machine and gives the same bits on machines with
//! the same features. There are two ways to use them:
//! - [`Vectorised`]: plain code, marked `#[inline(always)]`, which the compiler vectorises for the baseline and for
//!   AVX2 with FMA.
//! - [`Wide`]: code over explicit vectors of eight numbers, for loops with more running sums than the compiler would
//!   keep in vector registers.
#![allow(unsafe_code)]

mod elementary;
#[cfg(target_arch = "aarch64")]
mod neon;
#[cfg(any(test, not(target_arch = "aarch64")))]
mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

use std::sync::atomic::{AtomicBool, Ordering};

pub(crate) use elementary::{atan, sin_cos};
#[cfg(any(test, not(target_arch = "aarch64")))]
use portable::Portable;

use crate::kernel::Lanes;

/// Whether [`vectorised`] uses the instruction set of the build.
static BASELINE_QP: AtomicBool = AtomicBool::new(false);

/// Makes the QP solver of this process use the instruction set of the build from now on, which takes longer and changes
/// the rounding of its results.
///
/// This is for counting instructions only: Valgrind 3.19 lacks one encoding of `vmovq` that the compiler uses with
/// AVX2. A feature would choose the same, but this crate and all that use it would be compiled once more for it.
#[doc(hidden)]
pub fn count_with_baseline_qp() {
    BASELINE_QP.store(true, Ordering::Relaxed);
}

/// A computation that is compiled for several instruction sets.
pub(crate) trait Vectorised {
    /// Result of the computation.
    type Output;
    /// Runs the computation. Implementations must be `#[inline(always)]`, otherwise they are not vectorised.
    fn compute(self) -> Self::Output;
}

/// A computation over vectors of eight numbers.
pub(crate) trait Wide {
    /// Result of the computation.
    type Output;
    /// Runs the computation. Implementations and the functions they call with `simd` must be `#[inline(always)]`.
    fn compute<S: Simd>(self, simd: S) -> Self::Output;
}

/// Arithmetic on vectors of eight numbers, lane by lane. A value of this type proves that the machine has the
/// instruction set, because only feature detection creates it.
pub(crate) trait Simd: Copy {
    /// Name of the instructions.
    const NAME: &'static str;
    /// Running sums that fit into the registers beside two operands.
    const SUMS: usize;
    /// Number of vectors of eight numbers that the registers hold.
    const REGISTERS: usize;
    /// Eight numbers.
    type V: Copy;
    /// One number in all lanes.
    fn splat(self, x: f64) -> Self::V;
    fn load(self, x: &Lanes) -> Self::V;
    fn store(self, x: Self::V) -> Lanes;
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a b + c`, rounded once.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    fn sqrt(self, a: Self::V) -> Self::V;
    /// The larger of `a` and `b`; `b` if either is NaN.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// `x` in the lanes in which `a > b`, otherwise `y`, also where `a` or `b` is NaN.
    fn where_greater(self, a: Self::V, b: Self::V, x: Self::V, y: Self::V) -> Self::V;
    /// `((a₀ + a₄) + (a₂ + a₆)) + ((a₁ + a₅) + (a₃ + a₇))`.
    fn sum(self, a: Self::V) -> f64;
    /// Looks up `table` at the low three bits of `eighths` and adds the bits of `eighths`, shifted left by 49, to the
    /// bits of the entry. The bits of `eighths` above the lowest three are thus added to its exponent.
    fn add_exponent(self, table: Self::V, eighths: Self::V) -> Self::V;
}

/// Runs a computation with the best instruction set of this machine except for 512-bit vectors, which are slower for
/// the small matrices of the QP solver. After [`count_with_baseline_qp`] it uses the instruction set of the build.
pub(crate) fn vectorised<C: Vectorised>(computation: C) -> C::Output {
    dispatched(computation, BASELINE_QP.load(Ordering::Relaxed))
}

/// Like [`vectorised`] but independent of [`count_with_baseline_qp`]; for plain loops over long arrays.
pub(crate) fn vectorised_loops<C: Vectorised>(computation: C) -> C::Output {
    dispatched(computation, false)
}

/// Runs a computation with AVX2 if this machine has it, or with the `baseline`, of which the program has one copy.
#[cfg_attr(not(target_arch = "x86_64"), allow(unused_variables))]
fn dispatched<C: Vectorised>(computation: C, baseline: bool) -> C::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        fn avx2<C: Vectorised>(computation: C) -> C::Output {
            computation.compute()
        }
        if !baseline && x86::Avx2::detect().is_some() {
            // SAFETY: both features were found on this machine.
            return unsafe { avx2(computation) };
        }
    }
    computation.compute()
}

/// Runs a computation with the widest vectors of this machine.
pub(crate) fn wide<C: Wide>(computation: C) -> C::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f,avx512vl,avx2,fma")]
        fn avx512<C: Wide>(computation: C, simd: x86::Avx512) -> C::Output {
            computation.compute(simd)
        }
        #[target_feature(enable = "avx2,fma")]
        fn avx2<C: Wide>(computation: C, simd: x86::Avx2) -> C::Output {
            computation.compute(simd)
        }
        if let Some(simd) = x86::Avx512::detect() {
            // SAFETY: the features were found on this machine.
            return unsafe { avx512(computation, simd) };
        }
        if let Some(simd) = x86::Avx2::detect() {
            // SAFETY: both features were found on this machine.
            return unsafe { avx2(computation, simd) };
        }
    }
    #[cfg(target_arch = "aarch64")]
    return computation.compute(neon::Neon);
    #[cfg(not(target_arch = "aarch64"))]
    computation.compute(Portable)
}

/// Results of a computation with every instruction set of this machine, the portable one first.
#[cfg(test)]
pub(crate) fn with_each<C: Wide + Copy>(computation: C) -> Vec<C::Output> {
    let mut results = vec![computation.compute(Portable)];
    #[cfg(target_arch = "x86_64")]
    {
        results.extend(x86::Avx2::detect().map(|simd| computation.compute(simd)));
        results.extend(x86::Avx512::detect().map(|simd| computation.compute(simd)));
    }
    #[cfg(target_arch = "aarch64")]
    results.push(computation.compute(neon::Neon));
    results
}

/// Name of the vector instructions that this machine's Gaussian processes use: `AVX-512`, `AVX2`, `NEON` or `none`.
///
/// Results of machines whose names differ may differ by rounding.
pub fn vector_instructions() -> &'static str {
    struct Name;
    impl Wide for Name {
        type Output = &'static str;
        #[inline(always)]
        fn compute<S: Simd>(self, _: S) -> &'static str {
            S::NAME
        }
    }
    wide(Name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::LANES;

    /// Numbers whose sum depends on the order of summation.
    const SUMMANDS: Lanes = [0.1, 0.2, 0.3, 1e8, -0.7, 1e-3, 7.0, 1.0 / 3.0];

    /// Results of every method for operands that differ in all lanes.
    #[derive(Clone, Copy)]
    struct All;

    impl Wide for All {
        type Output = [Lanes; 11];

        #[inline(always)]
        fn compute<S: Simd>(self, simd: S) -> [Lanes; 11] {
            all(simd)
        }
    }

    #[inline(always)]
    fn all<S: Simd>(simd: S) -> [Lanes; 11] {
        let a = simd.load(&[1.5, -2.0, 3.25, 0.0, 1e300, 7.0, -1e-3, 9.0]);
        let b = simd.load(&[0.1, 4.0, f64::NAN, 2.0, 5.0, -6.0, 7e3, 0.3]);
        let shifted = simd.add(a, simd.splat(844_424_930_131_968.0)); // 1.5 · 2⁴⁹: rounds to eighths
        let table = std::array::from_fn(|k| k as f64 + 1.0);
        [
            simd.store(simd.add(a, b)),
            simd.store(simd.sub(a, b)),
            simd.store(simd.mul(a, b)),
            simd.store(simd.mul_add(a, b, simd.splat(0.7))),
            simd.store(simd.sqrt(simd.max(simd.splat(0.0), a))),
            simd.store(simd.max(a, b)),
            simd.store(simd.max(b, a)),
            simd.store(simd.div(a, b)),
            simd.store(simd.where_greater(a, b, b, a)),
            simd.store(simd.add_exponent(simd.load(&table), shifted)),
            [simd.sum(simd.load(&SUMMANDS)); LANES],
        ]
    }

    #[test]
    fn instruction_sets_agree_bit_by_bit() {
        let bits = |x: [Lanes; 11]| x.map(|x| x.map(|x| if x.is_nan() { 0 } else { x.to_bits() }));
        let results = with_each(All);
        let portable = results[0];
        for result in results {
            assert_eq!(bits(result), bits(portable));
        }
        assert_eq!(portable[9][..4], [14.0, 0.25, 28.0, 1.0]);
        let [a, b, c, d, e, f, g, h] = SUMMANDS;
        let sum = ((a + e) + (c + g)) + ((b + f) + (d + h));
        assert_eq!(portable[10][0].to_bits(), sum.to_bits());
        assert_ne!(sum.to_bits(), SUMMANDS.iter().sum::<f64>().to_bits());
    }
}
