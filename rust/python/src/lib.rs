//! The `_core` extension: adapters between Python and the Rust crates, nothing else.

#![allow(clippy::needless_pass_by_value)] // pyo3 hands arguments over by value

mod array;
mod driver;
mod error;
mod gate;
mod library;
mod library_writer;
mod ocp;
mod parameters;
mod path;
mod plant;
mod problem;
mod service;
mod surface;
mod wire;

use pyo3::prelude::*;

/// The private extension module behind `egp_service`.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    driver::register(module)?;
    error::register(module)?;
    gate::register(module)?;
    library::register(module)?;
    library_writer::register(module)?;
    ocp::register(module)?;
    parameters::register(module)?;
    path::register(module)?;
    plant::register(module)?;
    problem::register(module)?;
    service::register(module)?;
    surface::register(module)?;
    wire::register(module)?;
    Ok(())
}
