//! Zones of friction along a path.

use egp_parameters::Surface;

use crate::error::PathError;

/// A stretch of road with its own surface, until the next zone or the path's end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zone {
    /// Start as a fraction of the path's length in `[0, 1)`.
    pub start: f64,
    /// The surface.
    pub surface: Surface,
    /// The surface to the right of the path, if the road is split along it.
    pub right: Option<Surface>,
}

impl Zone {
    /// A zone with the same surface, or the same friction coefficient, on both sides of the path.
    pub fn new(start: f64, surface: impl Into<Surface>) -> Self {
        Self {
            start,
            surface: surface.into(),
            right: None,
        }
    }

    fn on_the_right(self) -> Surface {
        self.right.unwrap_or(self.surface)
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
        for surface in [zone.surface, zone.on_the_right()] {
            surface.validate()?;
        }
        before = Some(start);
    }
    Ok(())
}

/// `[left, right]` surface at a fraction of the length in `[0, 1]`; dry without zones.
pub(crate) fn sides_at(zones: &[Zone], fraction: f64) -> [Surface; 2] {
    let next = zones.partition_point(|zone| zone.start <= fraction);
    zones[..next].last().map_or([Surface::DRY; 2], |zone| {
        [zone.surface, zone.on_the_right()]
    })
}
