//! Vector instructions of x86-64: AVX-512, and AVX2 with FMA.

use std::arch::is_x86_feature_detected as has;
#[allow(clippy::wildcard_imports)] // two dozen intrinsics
use std::arch::x86_64::*;

use super::Simd;
use crate::kernel::{LANES, Lanes};

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
        div(a: __m512d, b: __m512d) -> __m512d = _mm512_div_pd(a, b);
        sqrt(a: __m512d) -> __m512d = _mm512_sqrt_pd(a);
        max(a: __m512d, b: __m512d) -> __m512d = _mm512_max_pd(a, b);
        where_greater(a: __m512d, b: __m512d, x: __m512d, y: __m512d) -> __m512d =
            _mm512_mask_blend_pd(_mm512_cmp_pd_mask::<_CMP_GT_OQ>(a, b), y, x);
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
        div(a: Pair, b: Pair) -> Pair = Pair(_mm256_div_pd(a.0, b.0), _mm256_div_pd(a.1, b.1));
        sqrt(a: Pair) -> Pair = Pair(_mm256_sqrt_pd(a.0), _mm256_sqrt_pd(a.1));
        max(a: Pair, b: Pair) -> Pair = Pair(_mm256_max_pd(a.0, b.0), _mm256_max_pd(a.1, b.1));
        where_greater(a: Pair, b: Pair, x: Pair, y: Pair) -> Pair = {
            let low = _mm256_cmp_pd::<_CMP_GT_OQ>(a.0, b.0);
            let high = _mm256_cmp_pd::<_CMP_GT_OQ>(a.1, b.1);
            Pair(_mm256_blendv_pd(y.0, x.0, low), _mm256_blendv_pd(y.1, x.1, high))
        };
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
