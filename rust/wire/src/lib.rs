//! egp-wire.
