//! The `_core` extension: adapters between Python and the Rust crates, nothing else.

use pyo3::prelude::*;

/// The private extension module behind `egp_service`.
#[pymodule]
fn _core(_module: &Bound<'_, PyModule>) -> PyResult<()> {
    Ok(())
}
