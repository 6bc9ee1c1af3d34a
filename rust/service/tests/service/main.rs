//! Tests of a real service and real clients over TCP on the loopback.

mod allocation;
mod common;
mod cores;
mod draining;
mod hostile;
mod queueing;
mod serving;
