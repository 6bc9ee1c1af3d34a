//! The `_core` extension: adapters between Python and the Rust crates, nothing else.

mod error;

use pyo3::prelude::*;

/// The private extension module behind `egp_service`.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    error::register(module)?;
    Ok(())
}
