//! egp-simulator.
