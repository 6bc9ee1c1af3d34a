//! The exceptions that `_core` raises, all under `EgpError`.

use std::fmt::Display;

use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

create_exception!(egp_service._core, EgpError, PyValueError, doc!(EgpError));
create_exception!(
    egp_service._core,
    InvalidArgumentError,
    EgpError,
    doc!(InvalidArgumentError)
);
create_exception!(
    egp_service._core,
    LibraryError,
    EgpError,
    doc!(LibraryError)
);
create_exception!(
    egp_service._core,
    VehicleLostError,
    EgpError,
    doc!(VehicleLostError)
);
create_exception!(
    egp_service._core,
    RefusedError,
    EgpError,
    doc!(RefusedError)
);

/// A typed Rust error as `EgpError` with the same message, for `.map_err(raise)?` at the boundary.
pub fn raise(error: impl Display) -> PyErr {
    EgpError::new_err(error.to_string())
}

impl InvalidArgumentError {
    /// A typed Rust error as this exception with the same message.
    pub fn raise(error: impl Display) -> PyErr {
        Self::new_err(error.to_string())
    }
}
