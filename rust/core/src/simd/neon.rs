//! Vector instructions of 64-bit Arm: NEON, which every such processor has.

use std::arch::aarch64::*;

use super::Simd;
use crate::kernel::{LANES, Lanes};

/// NEON, whose vectors hold two numbers.
#[derive(Clone, Copy)]
pub(super) struct Neon;

/// Lanes 0 and 1, 2 and 3, 4 and 5, 6 and 7.
type Pairs = [float64x2_t; LANES / 2];

/// Methods that apply one intrinsic to each pair of lanes.
macro_rules! pairwise {
    ($($name:ident($($x:ident),*) = $body:expr;)*) => {$(
        #[inline(always)]
        fn $name(self, $($x: Pairs),*) -> Pairs {
            // SAFETY: every 64-bit Arm processor has NEON.
            std::array::from_fn(|p| unsafe {
                $(let $x = $x[p];)*
                $body
            })
        }
    )*};
}

impl Simd for Neon {
    const NAME: &'static str = "NEON";
    const SUMS: usize = 6;
    const REGISTERS: usize = 8;
    type V = Pairs;

    #[inline(always)]
    fn splat(self, x: f64) -> Pairs {
        // SAFETY: every 64-bit Arm processor has NEON.
        [unsafe { vdupq_n_f64(x) }; LANES / 2]
    }
    #[inline(always)]
    fn load(self, x: &Lanes) -> Pairs {
        // SAFETY: every 64-bit Arm processor has NEON; `2p + 1` is at most the index of the last lane.
        std::array::from_fn(|p| unsafe { vld1q_f64(x.as_ptr().add(2 * p)) })
    }
    #[inline(always)]
    fn store(self, x: Pairs) -> Lanes {
        let mut out = [0.0; LANES];
        for (pair, x) in out.chunks_exact_mut(2).zip(x) {
            // SAFETY: every 64-bit Arm processor has NEON; `pair` has two numbers.
            unsafe { vst1q_f64(pair.as_mut_ptr(), x) };
        }
        out
    }

    pairwise! {
        add(a, b) = vaddq_f64(a, b);
        sub(a, b) = vsubq_f64(a, b);
        mul(a, b) = vmulq_f64(a, b);
        mul_add(a, b, c) = vfmaq_f64(c, a, b);
        div(a, b) = vdivq_f64(a, b);
        sqrt(a) = vsqrtq_f64(a);
        max(a, b) = vbslq_f64(vcgtq_f64(a, b), a, b);
        where_greater(a, b, x, y) = vbslq_f64(vcgtq_f64(a, b), x, y);
    }

    #[inline(always)]
    fn sum(self, a: Pairs) -> f64 {
        // SAFETY: every 64-bit Arm processor has NEON.
        unsafe {
            let two = vaddq_f64(vaddq_f64(a[0], a[2]), vaddq_f64(a[1], a[3]));
            vgetq_lane_f64::<0>(two) + vgetq_lane_f64::<1>(two)
        }
    }

    #[inline(always)]
    fn add_exponent(self, table: Pairs, eighths: Pairs) -> Pairs {
        /// Each byte's index within its number.
        const BYTES: u64 = 0x0706_0504_0302_0100;
        /// The lowest byte of each of two numbers, eight times.
        const LOWEST: [u8; 16] = [0, 0, 0, 0, 0, 0, 0, 0, 8, 8, 8, 8, 8, 8, 8, 8];
        // SAFETY: every 64-bit Arm processor has NEON; `LOWEST` has sixteen bytes.
        unsafe {
            let bytes = uint8x16x4_t(
                vreinterpretq_u8_f64(table[0]),
                vreinterpretq_u8_f64(table[1]),
                vreinterpretq_u8_f64(table[2]),
                vreinterpretq_u8_f64(table[3]),
            );
            let (lowest, offsets) = (
                vld1q_u8(LOWEST.as_ptr()),
                vreinterpretq_u8_u64(vdupq_n_u64(BYTES)),
            );
            eighths.map(|k| {
                let entry = vandq_u8(vqtbl1q_u8(vreinterpretq_u8_f64(k), lowest), vdupq_n_u8(7));
                let entry = vqtbl4q_u8(bytes, vorrq_u8(vshlq_n_u8::<3>(entry), offsets));
                let exponent = vshlq_n_u64::<49>(vreinterpretq_u64_f64(k));
                vreinterpretq_f64_u64(vaddq_u64(vreinterpretq_u64_u8(entry), exponent))
            })
        }
    }
}
