//! Matérn kernel with ν = 5/2.

use super::exp::exp;
use super::{Lanes, Profile};

/// `φ(r²) = (1 + a + a²/3) exp(-a)`, `a = √5 r`; Rasmussen & Williams (2006), eq. (4.17).
///
/// Its slope `dφ/d(r²) = -5/6 (1 + a) exp(-a)` has no division by `r`.
#[derive(Debug)]
pub struct Matern52;

impl Profile for Matern52 {
    #[inline(always)]
    fn value(r2: &Lanes) -> Lanes {
        Self::value_slope(r2).0
    }

    #[inline(always)]
    fn value_slope(r2: &Lanes) -> (Lanes, Lanes) {
        let a = r2.map(|r2| (5.0 * r2).sqrt());
        let decay = exp(&a.map(|a| -a));
        let value = std::array::from_fn(|l| (1.0 + a[l] + a[l] * a[l] / 3.0) * decay[l]);
        let slope = std::array::from_fn(|l| -5.0 / 6.0 * (1.0 + a[l]) * decay[l]);
        (value, slope)
    }
}
