//! egp-gate.
