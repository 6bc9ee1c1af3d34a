//! Benchmarks of the mathematics and of the plant with criterion.
//!
//! They are a crate of their own because criterion enables features of crates that zenoh depends on, too. Tests and
//! programs are built without this crate, so that they share one build of zenoh.
