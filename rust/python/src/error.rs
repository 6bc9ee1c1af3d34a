//! The exceptions that `_core` raises, all under `EgpError`.

use std::fmt::Display;

use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

create_exception!(
    egp_service._core,
    EgpError,
    PyValueError,
    "An input that cannot be used or a computation that failed; the message says what was expected and what came."
);
create_exception!(
    egp_service._core,
    InvalidArgumentError,
    EgpError,
    "An argument of the wrong shape, or with a value outside its domain."
);
create_exception!(
    egp_service._core,
    RefusedError,
    EgpError,
    "The control step answered a request with an error; the message begins with the error's code."
);

/// A typed Rust error as `EgpError`, keeping its message.
///
/// Used as `.map_err(raise)?` at the boundary.
pub fn raise(error: impl Display) -> PyErr {
    EgpError::new_err(error.to_string())
}

impl InvalidArgumentError {
    /// A typed Rust error as this exception, keeping its message.
    pub fn raise(error: impl Display) -> PyErr {
        Self::new_err(error.to_string())
    }
}

/// Adds the exceptions to the module.
///
/// # Errors
/// Errors if the module does not accept the name.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("EgpError", py.get_type::<EgpError>())?;
    module.add(
        "InvalidArgumentError",
        py.get_type::<InvalidArgumentError>(),
    )?;
    module.add("RefusedError", py.get_type::<RefusedError>())
}
