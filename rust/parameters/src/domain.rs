//! Ranges of the numbers in requests and replies that several crates check. [`REFERENCE_SPEED`], [`MOST_WIDTH`] and the
//! ranges of a measured state are checked by the driver and the control step; the ranges of the messages themselves are
//! wider (`docs/wire.md`, section 3).

/// Largest magnitude of any number; no quantity of a road vehicle in SI units is larger.
pub const MAGNITUDE: f64 = 1e7;

/// Largest magnitudes of the states `[p_x, p_y, v_x, psi, v_y, omega, delta]` in messages, in m, m/s, rad and rad/s. The yaw
/// is unwrapped, and positions may be UTM coordinates.
pub const STATE_IN_MESSAGES: [f64; 7] = [MAGNITUDE, MAGNITUDE, 150.0, 1e5, 150.0, 50.0, 1.6];

/// Largest longitudinal force in messages, N. An engine is not made for a vehicle that needs more; the control step checks
/// the acceleration.
pub const MOST_FORCE: f64 = 1e6;

/// Smallest and largest friction coefficient that a request may state for a road.
pub const ROAD_FRICTION: (f64, f64) = (0.01, 3.0);

/// Smallest and largest measured longitudinal speed, m/s. A standing vehicle measures noise around zero.
pub const MEASURED_SPEED: (f64, f64) = (-1.0, 100.0);

/// Largest magnitude of a measured lateral speed, m/s.
pub const MOST_LATERAL_SPEED: f64 = 50.0;

/// Largest magnitude of a measured yaw rate, rad/s.
pub const MOST_YAW_RATE: f64 = 20.0;

/// Largest magnitude of a measured steering angle, rad.
pub const MOST_STEERING_ANGLE: f64 = 1.5;

/// Smallest and largest speed of a reference, m/s. Rounding may make that of a standstill negative.
pub const REFERENCE_SPEED: (f64, f64) = (-1.0, 100.0);

/// Largest magnitude of the distance from a reference to a track edge, m.
pub const MOST_WIDTH: f64 = 1e3;

/// Largest distance of weights from the simplex: of their sum from 1, and of one of them below 0.
pub const SIMPLEX_TOLERANCE: f64 = 1e-6;
