//! Checks of single numbers.

use super::SettingsError;

/// Largest value of a setting without a range of its own.
pub(super) const LARGEST: f64 = 1e9;

/// Errors unless `got` is finite and `accept` is true for it.
pub(super) fn check(
    field: &'static str,
    got: f64,
    expected: &'static str,
    accept: impl Fn(f64) -> bool,
) -> Result<(), SettingsError> {
    if got.is_finite() && accept(got) {
        Ok(())
    } else {
        Err(SettingsError::Range {
            field,
            expected,
            got,
        })
    }
}

/// Errors unless `got` is positive. No quantity here has a use beyond these limits, and products of several such numbers
/// neither overflow nor vanish within them.
pub(super) fn positive(field: &'static str, got: f64) -> Result<(), SettingsError> {
    check(field, got, "positive, from 1e-9 to 1e9", |v| {
        (1e-9..=LARGEST).contains(&v)
    })
}

pub(super) fn positive_if_stated(
    field: &'static str,
    got: Option<f64>,
) -> Result<(), SettingsError> {
    got.map_or(Ok(()), |value| positive(field, value))
}

pub(super) fn not_negative(field: &'static str, got: f64) -> Result<(), SettingsError> {
    check(field, got, "not negative, at most 1e9", |v| {
        (0.0..=LARGEST).contains(&v)
    })
}
