//! The exceptions that `_core` raises, all under `EgpError`.

use std::fmt::Display;
use std::io;

use pyo3::create_exception;
use pyo3::exceptions::{PyTypeError, PyValueError};
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

/// The text of an error of the system without the number that Rust puts behind it.
pub fn system_text(error: &io::Error) -> String {
    let text = error.to_string();
    let number = error.raw_os_error();
    let number = number.map(|number| format!(" (os error {number})"));
    match number.and_then(|number| text.strip_suffix(&number)) {
        Some(text) => text.to_owned(),
        None => text,
    }
}

/// The error about an object of another type than the argument `name` may have. It shows the object's `repr`, or its type if
/// the `repr` is longer than 60 characters, has several lines or raises an exception.
pub fn wrong_type(name: &str, expected: &str, object: Borrowed<'_, '_, PyAny>) -> PyErr {
    /// More characters would hide the rest of the message.
    const MOST: usize = 60;
    let found = match object.repr().map(|text| text.to_string()) {
        Ok(text) if text.chars().count() <= MOST && !text.contains('\n') => text,
        _ => match object.get_type().name() {
            Ok(kind) => format!("an object of the type {kind}"),
            Err(_) => "another object".to_owned(),
        },
    };
    PyTypeError::new_err(format!("{name}: expected {expected}, got {found}"))
}

impl InvalidArgumentError {
    /// A typed Rust error as this exception with the same message.
    pub fn raise(error: impl Display) -> PyErr {
        Self::new_err(error.to_string())
    }
}
