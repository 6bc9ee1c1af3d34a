//! Vector instructions: the only file of this crate with `unsafe`.
//!
//! The features are detected at run time, so one binary serves every machine and gives the same bits on machines with
//! the same features. There are two ways to use them:
//! - [`Vectorised`]: plain code, marked `#[inline(always)]`, which the compiler vectorises for the baseline and for
//!   AVX2 with FMA.
//! - [`Wide`]: code over explicit vectors of eight numbers, for loops with more running sums than the compiler would
//!   keep in vector registers.
#![allow(unsafe_code)]

use crate::kernel::{LANES, Lanes};

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
    fn sqrt(self, a: Self::V) -> Self::V;
    /// The larger of `a` and `b`; `b` if either is NaN.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// `((a₀ + a₄) + (a₂ + a₆)) + ((a₁ + a₅) + (a₃ + a₇))`.
    fn sum(self, a: Self::V) -> f64;
    /// Looks up `table` at the low three bits of `eighths` and adds the bits of `eighths`, shifted left by 49, to the
    /// bits of the entry. The bits of `eighths` above the lowest three are thus added to its exponent.
    fn add_exponent(self, table: Self::V, eighths: Self::V) -> Self::V;
}

/// Runs a computation with the best instruction set of this machine except for 512-bit vectors, which are slower for
/// the small matrices of the QP solver. With the feature `baseline-qp` it uses the instruction set of the build.
pub(crate) fn vectorised<C: Vectorised>(computation: C) -> C::Output {
    if cfg!(feature = "baseline-qp") {
        return computation.compute();
    }
    vectorised_loops(computation)
}

/// Like [`vectorised`] but independent of the features of the build; for plain loops over long arrays.
pub(crate) fn vectorised_loops<C: Vectorised>(computation: C) -> C::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        fn avx2<C: Vectorised>(computation: C) -> C::Output {
            computation.compute()
        }
        if x86::Avx2::detect().is_some() {
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
    results
}

/// Name of the vector instructions that this machine's Gaussian processes use: `AVX-512`, `AVX2` or `none`.
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

/// Plain Rust, for machines without AVX2.
#[derive(Clone, Copy)]
struct Portable;

impl Simd for Portable {
    const NAME: &'static str = "none";
    const SUMS: usize = 2;
    const REGISTERS: usize = 8;
    type V = Lanes;

    #[inline(always)]
    fn splat(self, x: f64) -> Lanes {
        [x; LANES]
    }
    #[inline(always)]
    fn load(self, x: &Lanes) -> Lanes {
        *x
    }
    #[inline(always)]
    fn store(self, x: Lanes) -> Lanes {
        x
    }
    #[inline(always)]
    fn add(self, a: Lanes, b: Lanes) -> Lanes {
        std::array::from_fn(|l| a[l] + b[l])
    }
    #[inline(always)]
    fn sub(self, a: Lanes, b: Lanes) -> Lanes {
        std::array::from_fn(|l| a[l] - b[l])
    }
    #[inline(always)]
    fn mul(self, a: Lanes, b: Lanes) -> Lanes {
        std::array::from_fn(|l| a[l] * b[l])
    }
    #[inline(always)]
    fn mul_add(self, a: Lanes, b: Lanes, c: Lanes) -> Lanes {
        std::array::from_fn(|l| a[l].mul_add(b[l], c[l]))
    }
    #[inline(always)]
    fn sqrt(self, a: Lanes) -> Lanes {
        a.map(f64::sqrt)
    }
    #[inline(always)]
    fn max(self, a: Lanes, b: Lanes) -> Lanes {
        std::array::from_fn(|l| if a[l] > b[l] { a[l] } else { b[l] })
    }
    #[inline(always)]
    fn sum(self, a: Lanes) -> f64 {
        ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]))
    }
    #[inline(always)]
    fn add_exponent(self, table: Lanes, eighths: Lanes) -> Lanes {
        eighths.map(|k| {
            let bits = k.to_bits();
            f64::from_bits(
                table[(bits & 7) as usize]
                    .to_bits()
                    .wrapping_add(bits << 49),
            )
        })
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::is_x86_feature_detected as has;
    #[allow(clippy::wildcard_imports)] // two dozen intrinsics
    use std::arch::x86_64::*;

    use super::{LANES, Lanes, Simd};

    /// AVX-512F with AVX-512VL (without which only half of the registers can be split into halves), AVX2 and FMA.
    #[derive(Clone, Copy)]
    pub(super) struct Avx512(());

    /// AVX2 with FMA.
    #[derive(Clone, Copy)]
    pub(super) struct Avx2(());

    impl Avx512 {
        pub fn detect() -> Option<Self> {
            (has!("avx512f") && has!("avx512vl") && Avx2::detect().is_some()).then_some(Self(()))
        }
    }

    impl Avx2 {
        pub fn detect() -> Option<Self> {
            (has!("avx2") && has!("fma")).then_some(Self(()))
        }
    }

    /// [`Simd::sum`] of the low and the high four lanes.
    ///
    /// # Safety
    /// The machine must have AVX.
    #[inline(always)]
    unsafe fn sum_of_halves(low: __m256d, high: __m256d) -> f64 {
        // SAFETY: the caller guarantees that the machine has AVX.
        unsafe {
            let four = _mm256_add_pd(low, high);
            let two = _mm_add_pd(
                _mm256_castpd256_pd128(four),
                _mm256_extractf128_pd::<1>(four),
            );
            _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
        }
    }

    /// Methods that consist of one expression with intrinsics.
    macro_rules! intrinsics {
        ($($name:ident($($x:ident: $t:ty),*) -> $out:ty = $body:expr;)*) => {$(
            #[inline(always)]
            fn $name(self, $($x: $t),*) -> $out {
                // SAFETY: only `detect` creates `self`, on machines that have these instructions; loads and stores are
                // unaligned and stay inside an array of eight numbers.
                unsafe { $body }
            }
        )*};
    }

    impl Simd for Avx512 {
        const NAME: &'static str = "AVX-512";
        const SUMS: usize = 10;
        const REGISTERS: usize = 32;
        type V = __m512d;

        intrinsics! {
            splat(x: f64) -> __m512d = _mm512_set1_pd(x);
            load(x: &Lanes) -> __m512d = _mm512_loadu_pd(x.as_ptr());
            store(x: __m512d) -> Lanes = {
                let mut out = [0.0; LANES];
                _mm512_storeu_pd(out.as_mut_ptr(), x);
                out
            };
            add(a: __m512d, b: __m512d) -> __m512d = _mm512_add_pd(a, b);
            sub(a: __m512d, b: __m512d) -> __m512d = _mm512_sub_pd(a, b);
            mul(a: __m512d, b: __m512d) -> __m512d = _mm512_mul_pd(a, b);
            mul_add(a: __m512d, b: __m512d, c: __m512d) -> __m512d = _mm512_fmadd_pd(a, b, c);
            sqrt(a: __m512d) -> __m512d = _mm512_sqrt_pd(a);
            max(a: __m512d, b: __m512d) -> __m512d = _mm512_max_pd(a, b);
            sum(a: __m512d) -> f64 = {
                let high = _mm512_extractf64x4_pd::<1>(a);
                sum_of_halves(_mm512_castpd512_pd256(a), high)
            };
            add_exponent(table: __m512d, eighths: __m512d) -> __m512d = {
                let k = _mm512_castpd_si512(eighths);
                let entry = _mm512_castpd_si512(_mm512_permutexvar_pd(k, table));
                _mm512_castsi512_pd(_mm512_add_epi64(entry, _mm512_slli_epi64::<49>(k)))
            };
        }
    }

    /// The low and the high four lanes.
    #[derive(Clone, Copy)]
    pub(super) struct Pair(__m256d, __m256d);

    impl Simd for Avx2 {
        const NAME: &'static str = "AVX2";
        const SUMS: usize = 6;
        const REGISTERS: usize = 8;
        type V = Pair;

        intrinsics! {
            splat(x: f64) -> Pair = Pair(_mm256_set1_pd(x), _mm256_set1_pd(x));
            load(x: &Lanes) -> Pair = Pair(_mm256_loadu_pd(x.as_ptr()), _mm256_loadu_pd(x.as_ptr().add(4)));
            store(x: Pair) -> Lanes = {
                let mut out = [0.0; LANES];
                _mm256_storeu_pd(out.as_mut_ptr(), x.0);
                _mm256_storeu_pd(out.as_mut_ptr().add(4), x.1);
                out
            };
            add(a: Pair, b: Pair) -> Pair = Pair(_mm256_add_pd(a.0, b.0), _mm256_add_pd(a.1, b.1));
            sub(a: Pair, b: Pair) -> Pair = Pair(_mm256_sub_pd(a.0, b.0), _mm256_sub_pd(a.1, b.1));
            mul(a: Pair, b: Pair) -> Pair = Pair(_mm256_mul_pd(a.0, b.0), _mm256_mul_pd(a.1, b.1));
            mul_add(a: Pair, b: Pair, c: Pair) -> Pair =
                Pair(_mm256_fmadd_pd(a.0, b.0, c.0), _mm256_fmadd_pd(a.1, b.1, c.1));
            sqrt(a: Pair) -> Pair = Pair(_mm256_sqrt_pd(a.0), _mm256_sqrt_pd(a.1));
            max(a: Pair, b: Pair) -> Pair = Pair(_mm256_max_pd(a.0, b.0), _mm256_max_pd(a.1, b.1));
            sum(a: Pair) -> f64 = sum_of_halves(a.0, a.1);
            add_exponent(table: Pair, eighths: Pair) -> Pair = {
                // AVX2 looks up eight 32-bit words but not eight 64-bit numbers, so low and high words are looked up
                // apart.
                let halves = |x: Pair| (_mm256_castpd_ps(x.0), _mm256_castpd_ps(x.1));
                let (t, k) = (halves(table), halves(eighths));
                let sorted = |words| _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_castps_si256(words));
                let low = sorted(_mm256_shuffle_ps::<0b10_00_10_00>(t.0, t.1));
                let high = sorted(_mm256_shuffle_ps::<0b11_01_11_01>(t.0, t.1));
                let index = _mm256_castps_si256(_mm256_shuffle_ps::<0b10_00_10_00>(k.0, k.1));
                let low = _mm256_permutevar8x32_epi32(low, index);
                let high = _mm256_permutevar8x32_epi32(high, index);
                let add = |entry, k| {
                    let exponent = _mm256_slli_epi64::<49>(_mm256_castpd_si256(k));
                    _mm256_castsi256_pd(_mm256_add_epi64(entry, exponent))
                };
                Pair(
                    add(_mm256_unpacklo_epi32(low, high), eighths.0),
                    add(_mm256_unpackhi_epi32(low, high), eighths.1),
                )
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers whose sum depends on the order of summation.
    const SUMMANDS: Lanes = [0.1, 0.2, 0.3, 1e8, -0.7, 1e-3, 7.0, 1.0 / 3.0];

    /// Results of every method for operands that differ in all lanes.
    #[derive(Clone, Copy)]
    struct All;

    impl Wide for All {
        type Output = [Lanes; 9];

        #[inline(always)]
        fn compute<S: Simd>(self, simd: S) -> [Lanes; 9] {
            all(simd)
        }
    }

    #[inline(always)]
    fn all<S: Simd>(simd: S) -> [Lanes; 9] {
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
            simd.store(simd.add_exponent(simd.load(&table), shifted)),
            [simd.sum(simd.load(&SUMMANDS)); LANES],
        ]
    }

    #[test]
    fn instruction_sets_agree_bit_by_bit() {
        let bits = |x: [Lanes; 9]| x.map(|x| x.map(|x| if x.is_nan() { 0 } else { x.to_bits() }));
        let results = with_each(All);
        let portable = results[0];
        for result in results {
            assert_eq!(bits(result), bits(portable));
        }
        assert_eq!(portable[7][..4], [14.0, 0.25, 28.0, 1.0]);
        let [a, b, c, d, e, f, g, h] = SUMMANDS;
        let sum = ((a + e) + (c + g)) + ((b + f) + (d + h));
        assert_eq!(portable[8][0].to_bits(), sum.to_bits());
        assert_ne!(sum.to_bits(), SUMMANDS.iter().sum::<f64>().to_bits());
    }
}
