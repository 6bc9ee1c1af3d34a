//! The exponential of a block of numbers that are not positive.

use super::{LANES, Lanes};

/// `exp(x)` for `x <= 0`, to 2 units in the last place; below -708, where it is less than 4e-308, it is 0.
///
/// Range reduction `x = n ln 2 + r`, `|r| <= ln 2 / 2` (Cody & Waite, 1980), and the Taylor polynomial of degree 13,
/// whose remainder is 4e-18. No branch and no table: the compiler turns it into vector instructions.
#[inline(always)]
pub fn exp(x: &Lanes) -> Lanes {
    /// Adding this rounds to an integer and leaves it in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²
    const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1; // the upper 32 bits: n · LN_2_HIGH is exact
    const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
    const LOWEST: f64 = -708.0;
    let mut out = [0.0; LANES];
    for (out, x) in out.iter_mut().zip(x) {
        let clamped = x.max(LOWEST);
        let shifted = clamped.mul_add(std::f64::consts::LOG2_E, ROUND);
        let n = shifted - ROUND;
        let r = n.mul_add(-LN_2_LOW, n.mul_add(-LN_2_HIGH, clamped));
        let mut p = COEFFICIENTS[0];
        for c in &COEFFICIENTS[1..] {
            p = p.mul_add(r, *c);
        }
        let scale = f64::from_bits((shifted.to_bits() << 52).wrapping_add(1.0_f64.to_bits()));
        *out = if *x < LOWEST { 0.0 } else { p * scale };
    }
    out
}

/// `1/k!` for `k` = 13 down to 0.
const COEFFICIENTS: [f64; 14] = {
    let mut c = [1.0; 14];
    let mut k = 1;
    while k < 14 {
        c[13 - k] = c[14 - k] / k as f64;
        k += 1;
    }
    c
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_standard_library() {
        for i in 0..200_000 {
            let x = -708.0 * (f64::from(i) / 200_000.0).powi(3);
            let [got, ..] = exp(&[x; LANES]);
            let want = x.exp();
            assert!(
                (got / want - 1.0).abs() < 5e-16,
                "exp({x}) = {got:e}, not {want:e}"
            );
        }
    }

    #[test]
    fn far_below_it_is_zero() {
        for x in [-709.0, -1e6, f64::NEG_INFINITY] {
            assert_eq!(exp(&[x; LANES]), [0.0; LANES]);
        }
    }
}
