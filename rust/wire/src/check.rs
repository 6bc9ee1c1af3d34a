//! The declared domain of every quantity, and checks that name the field and the component at fault.

use egp_parameters::{
    MAGNITUDE, MOST_FORCE as FORCE, ROAD_FRICTION as FRICTION, SIMPLEX_TOLERANCE, STATE_IN_MESSAGES,
};

use crate::{Invalid, LibraryId, Predictions, VERSION};

/// A component's name and the largest magnitude accepted.
type Domain<const W: usize> = [(&'static str, f64); W];

// The limits are far beyond what a road vehicle reaches, and small enough that products of them stay exact to many
// digits. The control step accepts no number above `MAGNITUDE`, so no message may contain one, because a later request
// would carry it.
const POSITION: f64 = STATE_IN_MESSAGES[0];
const SPEED: f64 = STATE_IN_MESSAGES[2];
const YAW: f64 = STATE_IN_MESSAGES[3];
const YAW_RATE: f64 = STATE_IN_MESSAGES[5];
const STEERING: f64 = STATE_IN_MESSAGES[6];
const STEERING_RATE: f64 = 20.0; // rad/s
const WIDTH: f64 = 1e4; // m

pub(crate) const STATE: Domain<7> = [
    ("p_x", POSITION),
    ("p_y", POSITION),
    ("v_x", SPEED),
    ("psi", YAW),
    ("v_y", SPEED),
    ("omega", YAW_RATE),
    ("delta", STEERING),
];
pub(crate) const INPUT: Domain<2> = [("F_x", FORCE), ("delta_dot", STEERING_RATE)];
pub(crate) const GP_INPUT: Domain<6> = [
    ("v_x", SPEED),
    ("v_y", SPEED),
    ("omega", YAW_RATE),
    ("delta", STEERING),
    ("F_x", FORCE),
    ("delta_dot", STEERING_RATE),
];
pub(crate) const GP_OUTPUT: Domain<3> = [("v_x", SPEED), ("v_y", SPEED), ("omega", YAW_RATE)];
pub(crate) const REFERENCE: Domain<4> = [
    ("p_x", POSITION),
    ("p_y", POSITION),
    ("v_x", SPEED),
    ("psi", YAW),
];
pub(crate) const WIDTHS: Domain<2> = [("left", WIDTH), ("right", WIDTH)];

/// A number as errors show it: one of many digits with an exponent.
fn shown(value: f64) -> String {
    if value.is_finite() && value.abs() >= 1e9 {
        format!("{value:e}")
    } else {
        value.to_string()
    }
}

/// Errors unless every component of every row is inside its domain; NaN is outside.
pub(crate) fn domain<const W: usize>(
    field: &'static str,
    rows: &[[f64; W]],
    domain: &Domain<W>,
) -> Result<(), Invalid> {
    for (index, row) in rows.iter().enumerate() {
        for (value, (name, limit)) in row.iter().zip(domain) {
            if !(-limit..=*limit).contains(value) {
                return Err(Invalid::field(
                    field,
                    format!(
                        "row {index}: {name} = {} is outside ±{limit}",
                        shown(*value)
                    ),
                ));
            }
        }
    }
    Ok(())
}

/// Errors unless the weights are non-negative and sum to one, or are empty.
pub(crate) fn simplex(field: &'static str, weights: &[f64]) -> Result<(), Invalid> {
    if weights.is_empty() {
        return Ok(());
    }
    if let Some((index, weight)) = weights
        .iter()
        .enumerate()
        .find(|(_, w)| !(-SIMPLEX_TOLERANCE..=f64::MAX).contains(*w))
    {
        return Err(Invalid::field(
            field,
            format!("weight {index} = {} is negative", shown(*weight)),
        ));
    }
    let sum: f64 = weights.iter().sum();
    if !(1.0 - SIMPLEX_TOLERANCE..=1.0 + SIMPLEX_TOLERANCE).contains(&sum) {
        return Err(Invalid::field(
            field,
            format!("weights sum to {}, expected 1", shown(sum)),
        ));
    }
    Ok(())
}

/// Errors unless every row has the friction coefficient of a road and a standard deviation.
pub(crate) fn friction(field: &'static str, rows: &[[f64; 2]]) -> Result<(), Invalid> {
    let (least, most) = FRICTION;
    for (index, [friction, std]) in rows.iter().enumerate() {
        if !(least..=most).contains(friction) || !(0.0..=most).contains(std) {
            return Err(Invalid::field(
                field,
                format!(
                    "row {index}: expected a friction in [{least}, {most}] and a standard deviation in [0, {most}], got \
                     {} and {}",
                    shown(*friction),
                    shown(*std)
                ),
            ));
        }
    }
    Ok(())
}

/// Standard deviations that are not negative, in rows of finite numbers.
pub(crate) fn deviations<const W: usize>(
    field: &'static str,
    rows: &[[f64; W]],
) -> Result<(), Invalid> {
    match rows.as_flattened().iter().find(|value| **value < 0.0) {
        Some(value) => Err(Invalid::field(
            field,
            format!("a standard deviation is at least 0, got {}", shown(*value)),
        )),
        None => Ok(()),
    }
}

/// The weight of some of the members: between zero and one, up to the slack of the weights.
pub(crate) fn share(field: &'static str, value: f64) -> Result<(), Invalid> {
    if (-SIMPLEX_TOLERANCE..=1.0 + SIMPLEX_TOLERANCE).contains(&value) {
        return Ok(());
    }
    Err(Invalid::field(
        field,
        format!("expected a number in [0, 1], got {}", shown(value)),
    ))
}

/// The KKT residual of a solution: finite and not negative. Without a solution it may be infinite.
pub(crate) fn residual(field: &'static str, value: f64, solved: bool) -> Result<(), Invalid> {
    if value >= 0.0 && (value.is_finite() || !solved) {
        return Ok(());
    }
    Err(Invalid::field(
        field,
        format!(
            "expected a number of at least 0, finite if the status is solved, got {}",
            shown(value)
        ),
    ))
}

/// At least one, and at most `limit`.
pub(crate) fn count(field: &'static str, actual: usize, limit: usize) -> Result<(), Invalid> {
    if (1..=limit).contains(&actual) {
        return Ok(());
    }
    Err(Invalid::field(
        field,
        format!("expected 1 to {limit}, got {actual}"),
    ))
}

/// Errors unless there are exactly `expected` rows; `because` says what determines the number.
pub(crate) fn row_count(
    field: &'static str,
    actual: usize,
    expected: usize,
    because: &str,
) -> Result<(), Invalid> {
    if actual == expected {
        return Ok(());
    }
    Err(Invalid::field(
        field,
        format!("expected {expected} rows ({because}), got {actual}"),
    ))
}

pub(crate) fn version(actual: u32) -> Result<(), Invalid> {
    if actual == VERSION {
        Ok(())
    } else {
        Err(Invalid::Version { actual })
    }
}

pub(crate) fn library(bytes: &[u8]) -> Result<LibraryId, Invalid> {
    LibraryId::try_from(bytes).map_err(|_| {
        Invalid::field(
            "library",
            format!("expected the 32 bytes of a SHA-256, got {}", bytes.len()),
        )
    })
}

pub(crate) fn size(bytes: &[u8], limit: usize) -> Result<(), Invalid> {
    if bytes.len() <= limit {
        Ok(())
    } else {
        Err(Invalid::TooLarge {
            limit,
            actual: bytes.len(),
        })
    }
}

/// The largest budget of a request, µs; a longer one is in the wrong unit.
pub const MAX_BUDGET_US: u32 = 10_000_000;

pub(crate) fn budget(budget_us: u32) -> Result<(), Invalid> {
    if (1..=MAX_BUDGET_US).contains(&budget_us) {
        return Ok(());
    }
    Err(Invalid::field(
        "budget_us",
        format!("expected 1 to {MAX_BUDGET_US} µs, got {budget_us}"),
    ))
}

pub(crate) fn at_most(
    field: &'static str,
    actual: usize,
    limit: usize,
    because: &str,
) -> Result<(), Invalid> {
    if actual <= limit {
        return Ok(());
    }
    Err(Invalid::field(
        field,
        format!("expected at most {limit} ({because}), got {actual}"),
    ))
}

/// Errors unless `history_f` has at most one row per row of the history, each with one block per member.
///
/// Predictions have no domain except the largest magnitude, because a member may extrapolate far outside its data.
pub(crate) fn predictions(
    history_f: &Predictions,
    history_rows: usize,
    weights: &[f64],
) -> Result<(), Invalid> {
    const FIELD: &str = "history_f";
    if history_f.len() > history_rows {
        return Err(Invalid::field(
            FIELD,
            format!(
                "expected at most {history_rows} rows (as many as in history_z), got {}",
                history_f.len()
            ),
        ));
    }
    let found = history_f.members;
    if !history_f.is_empty() && !weights.is_empty() && found != weights.len() {
        return Err(Invalid::field(
            FIELD,
            format!(
                "expected {} members (as many as in weights), got {found}",
                weights.len()
            ),
        ));
    }
    if !history_f.values.len().is_multiple_of(found.max(1)) {
        return Err(Invalid::field(
            FIELD,
            format!("its last row has fewer than {found} members"),
        ));
    }
    let accepted = |value: &f64| value.abs() <= MAGNITUDE;
    if history_f.values.as_flattened().iter().all(accepted) {
        Ok(())
    } else {
        Err(Invalid::field(
            FIELD,
            format!("a prediction is NaN, infinite or larger than {MAGNITUDE} in magnitude"),
        ))
    }
}
