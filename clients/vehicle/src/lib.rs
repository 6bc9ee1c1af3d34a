//! egp-vehicle.
