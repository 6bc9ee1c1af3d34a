//! Numbers that are out of range.

use thiserror::Error;

/// A number that is not one of the accepted ones.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("expected {expected} for {name}, got {value}")]
pub struct OutOfRange {
    /// Name of the number.
    pub name: &'static str,
    /// The accepted numbers in words.
    pub expected: &'static str,
    /// The number given.
    pub value: f64,
}

/// Checks that `value` is finite and `accept` returns true.
///
/// # Errors
/// [`OutOfRange`] if not.
pub fn check(
    name: &'static str,
    value: f64,
    expected: &'static str,
    accept: impl Fn(f64) -> bool,
) -> Result<(), OutOfRange> {
    if value.is_finite() && accept(value) {
        Ok(())
    } else {
        Err(OutOfRange {
            name,
            expected,
            value,
        })
    }
}
