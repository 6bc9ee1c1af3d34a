//! The domain of the numbers in a request and a reply, where messages, the driver and the control step check the same.

/// Largest magnitude of any number; no quantity of a road vehicle in SI units is larger.
pub const MAGNITUDE: f64 = 1e7;

/// Largest longitudinal force in messages, N. An engine is not made for a vehicle that needs more; the control step checks
/// the acceleration.
pub const MOST_FORCE: f64 = 1e6;

/// Smallest and largest friction coefficient that a request may state for a road.
pub const ROAD_FRICTION: (f64, f64) = (0.01, 3.0);

/// Smallest and largest speed of a reference, m/s. Rounding may make that of a standstill negative.
pub const REFERENCE_SPEED: (f64, f64) = (-1.0, 100.0);

/// Largest magnitude of the distance from a reference to a track edge, m.
pub const MOST_WIDTH: f64 = 1e3;

/// Largest distance of weights from the simplex: of their sum from 1, and of one of them below 0.
pub const SIMPLEX_TOLERANCE: f64 = 1e-6;
