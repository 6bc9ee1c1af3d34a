//! Zones of friction along a path.

use crate::error::{PathError, check};

/// A stretch of road with one friction coefficient, until the next zone or the path's end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    /// Where it starts, as a fraction of the path's length in `[0, 1)`.
    pub start: f64,
    /// Friction coefficient.
    pub friction: f64,
}

/// Refuses zones that don't cover the path from its start in rising order.
pub(crate) fn check_zones(zones: &[Zone]) -> Result<(), PathError> {
    let mut before = None;
    for (index, &Zone { start, friction }) in zones.iter().enumerate() {
        if !before.map_or(start == 0.0, |before| start > before && start < 1.0) {
            return Err(PathError::ZoneStart { index, start });
        }
        check("friction", friction, "a positive number", |mu| mu > 0.0)?;
        before = Some(start);
    }
    Ok(())
}

/// Friction at a fraction of the length in `[0, 1]`; 1 where no zone says otherwise.
pub(crate) fn friction_at(zones: &[Zone], fraction: f64) -> f64 {
    let next = zones.partition_point(|zone| zone.start <= fraction);
    zones[..next].last().map_or(1.0, |zone| zone.friction)
}
