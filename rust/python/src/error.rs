//! The one exception class that everything in `_core` raises for refused input or a failed computation.

use std::fmt::Display;

use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

create_exception!(
    egp_service._core,
    EgpError,
    PyValueError,
    "A refused input or a failed computation; the message says what was expected and what came."
);

/// A typed Rust error as the Python exception, keeping its message.
///
/// Used as `.map_err(raise)?` at the boundary.
pub fn raise(error: impl Display) -> PyErr {
    EgpError::new_err(error.to_string())
}

/// Adds the exception to the module.
///
/// # Errors
/// When Python refuses the attribute.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("EgpError", module.py().get_type::<EgpError>())
}
