//! Squared-exponential kernel.

use super::exp::exp;
use super::{Lanes, Profile};

/// `φ(r²) = exp(-r²/2)`; Rasmussen & Williams (2006), eq. (4.9).
#[derive(Debug)]
pub struct Rbf;

impl Profile for Rbf {
    #[inline(always)]
    fn value(r2: &Lanes) -> Lanes {
        exp(&r2.map(|r2| -0.5 * r2))
    }

    #[inline(always)]
    fn value_slope(r2: &Lanes) -> (Lanes, Lanes) {
        let value = Self::value(r2);
        (value, value.map(|value| -0.5 * value))
    }
}
