//! egp-plant.
