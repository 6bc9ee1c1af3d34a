//! Tests of the gate.

mod limits;
mod properties;
mod waiting;
