//! Plain Rust, for x86-64 machines without AVX2 and for processors of other kinds.

use super::Simd;
use crate::kernel::{LANES, Lanes};

/// Lanes are the elements of an array.
#[derive(Clone, Copy)]
pub(super) struct Portable;

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
    fn div(self, a: Lanes, b: Lanes) -> Lanes {
        std::array::from_fn(|l| a[l] / b[l])
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
    fn where_greater(self, a: Lanes, b: Lanes, x: Lanes, y: Lanes) -> Lanes {
        std::array::from_fn(|l| if a[l] > b[l] { x[l] } else { y[l] })
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
