//! egp-path.
