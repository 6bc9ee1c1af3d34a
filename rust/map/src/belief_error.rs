//! The error about an argument of a belief that is out of range, and the checks that return it.

use egp_parameters::LEAST_LOG_LIKELIHOOD;
pub use egp_parameters::OutOfRange as BeliefError;
pub(crate) use egp_parameters::range::check;

/// Largest arc length, m.
const FARTHEST: f64 = 1e9;
/// Longest stretch to plan for, m.
const AHEAD: f64 = 1e4;

/// Errors unless `value` is an arc length whose cell can be counted.
pub(crate) fn place(name: &'static str, value: f64) -> Result<(), BeliefError> {
    check(name, value, "an arc length within ±1e9 m", |v| {
        v.abs() <= FARTHEST
    })
}

/// Errors unless a stretch of road can be planned for.
pub(crate) fn stretch(name: &'static str, length: f64) -> Result<(), BeliefError> {
    check(name, length, "at most 1e4 m", |v| v <= AHEAD)
}

/// Errors unless `value` is positive and finite.
pub(crate) fn positive(name: &'static str, value: f64) -> Result<(), BeliefError> {
    check(name, value, "a positive number", |v| {
        v > 0.0 && v.is_finite()
    })
}

/// Errors unless `value` is a logarithm of a likelihood as control steps state them. Smaller ones could overflow.
pub(crate) fn log_likelihood_of_step(name: &'static str, value: f64) -> Result<(), BeliefError> {
    check(name, value, "numbers from -1e6 to 0", |v| {
        (LEAST_LOG_LIKELIHOOD..=0.0).contains(&v)
    })
}

/// Errors unless `value` is between 0 and 1.
pub(crate) fn probability(name: &'static str, value: f64) -> Result<(), BeliefError> {
    check(name, value, "a probability in (0, 1)", |v| {
        v > 0.0 && v < 1.0
    })
}
