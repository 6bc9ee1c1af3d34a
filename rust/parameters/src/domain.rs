//! The domain of the numbers in a request and a reply: messages and the control step check it alike.

/// Largest magnitude of any number; no quantity of a road vehicle in SI units is larger.
pub const MAGNITUDE: f64 = 1e7;

/// Largest longitudinal force, N.
pub const MOST_FORCE: f64 = 1e6;

/// Smallest and largest friction coefficient that a request may state for a road.
pub const ROAD_FRICTION: (f64, f64) = (0.01, 3.0);

/// Largest distance of weights from the simplex: of their sum from 1, and of one of them below 0.
pub const SIMPLEX_TOLERANCE: f64 = 1e-6;
