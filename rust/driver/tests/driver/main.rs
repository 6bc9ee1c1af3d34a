//! Tests of the driver's parts.

mod carry;
mod gate;
