//! What a number must be for a belief to use it.

/// Largest arc length, m.
const FARTHEST: f64 = 1e9;
/// Longest stretch to plan for, m.
const AHEAD: f64 = 1e4;

/// A number that a belief cannot use.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("expected {expected} for {name}, got {value}")]
pub struct BeliefError {
    /// Name of the argument.
    pub name: &'static str,
    /// Accepted values.
    pub expected: &'static str,
    /// The value given.
    pub value: f64,
}

/// Errors unless `value` is an arc length whose cell can be counted.
pub(crate) fn place(name: &'static str, value: f64) -> Result<(), BeliefError> {
    if value.abs() <= FARTHEST {
        return Ok(());
    }
    Err(BeliefError {
        name,
        expected: "an arc length within ±1e9 m",
        value,
    })
}

/// Errors unless a stretch of road can be planned for.
pub(crate) fn stretch(name: &'static str, length: f64) -> Result<(), BeliefError> {
    if length <= AHEAD {
        return Ok(());
    }
    Err(BeliefError {
        name,
        expected: "at most 1e4 m",
        value: length,
    })
}

/// Errors unless `value` is positive and at most `limit`.
pub(crate) fn at_most(
    name: &'static str,
    value: f64,
    limit: f64,
    expected: &'static str,
) -> Result<(), BeliefError> {
    positive(name, value)?;
    if value <= limit {
        return Ok(());
    }
    Err(BeliefError {
        name,
        expected,
        value,
    })
}

/// Errors unless `value` is positive and finite.
pub(crate) fn positive(name: &'static str, value: f64) -> Result<(), BeliefError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(BeliefError {
        name,
        expected: "a positive number",
        value,
    })
}

/// Errors unless `value` is between 0 and 1.
pub(crate) fn probability(name: &'static str, value: f64) -> Result<(), BeliefError> {
    if value > 0.0 && value < 1.0 {
        return Ok(());
    }
    Err(BeliefError {
        name,
        expected: "a probability in (0, 1)",
        value,
    })
}
