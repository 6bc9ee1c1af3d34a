//! egp-core.
