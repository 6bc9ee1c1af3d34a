//! Zones of friction along a path.

use crate::error::{PathError, check};

/// A stretch of road with its own friction, until the next zone or the path's end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    /// Start as a fraction of the path's length in `[0, 1)`.
    pub start: f64,
    /// Friction coefficient.
    pub friction: f64,
    /// Friction coefficient to the right of the path, if the road is split along it.
    pub right: Option<f64>,
}

impl Zone {
    /// A zone with the same friction on both sides of the path.
    pub const fn new(start: f64, friction: f64) -> Self {
        Self {
            start,
            friction,
            right: None,
        }
    }

    fn on_the_right(self) -> f64 {
        self.right.unwrap_or(self.friction)
    }
}

/// Errors unless the zones cover the path from its start in increasing order.
pub(crate) fn check_zones(zones: &[Zone]) -> Result<(), PathError> {
    let mut before = None;
    for (index, zone) in zones.iter().enumerate() {
        let start = zone.start;
        if !before.map_or(start == 0.0, |before| start > before && start < 1.0) {
            return Err(PathError::ZoneStart { index, start });
        }
        for mu in [zone.friction, zone.on_the_right()] {
            check("friction", mu, "a positive number", |mu| mu > 0.0)?;
        }
        before = Some(start);
    }
    Ok(())
}

/// `[left, right]` friction at a fraction of the length in `[0, 1]`; 1 without zones.
pub(crate) fn sides_at(zones: &[Zone], fraction: f64) -> [f64; 2] {
    let next = zones.partition_point(|zone| zone.start <= fraction);
    zones[..next]
        .last()
        .map_or([1.0; 2], |zone| [zone.friction, zone.on_the_right()])
}
