//! Errors about library files, which come while Python's lock is released.

use std::io;
use std::path::{Path, PathBuf};

use egp_core::library;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

use crate::error::{LibraryError, system_text};

/// An error while Python's lock was released.
pub enum Failure {
    Refused(library::LibraryError),
    /// What is wrong with the library in this file.
    File(library::LibraryError, PathBuf),
    /// An error of the file system.
    Io {
        code: i32,
        message: String,
        path: PathBuf,
    },
}

/// An error of the file system about `path`.
pub fn os_error(error: &io::Error, path: &Path) -> Failure {
    // Errors of our own checks have no number.
    let code = error.raw_os_error().unwrap_or_else(|| match error.kind() {
        _ if path.is_dir() => libc::EISDIR,
        io::ErrorKind::InvalidInput => libc::EINVAL,
        _ => libc::EIO,
    });
    Failure::Io {
        code,
        message: system_text(error),
        path: path.to_owned(),
    }
}

fn refused(py: Python<'_>, message: String, refusal: &library::LibraryError) -> PyErr {
    let error = LibraryError::new_err(message);
    match error.value(py).setattr("code", refusal.code()) {
        Ok(()) => error,
        Err(error) => error,
    }
}

impl Failure {
    /// The error as an exception of Python.
    pub fn raise(self, py: Python<'_>) -> PyErr {
        match self {
            Self::Refused(refusal) => refused(py, refusal.to_string(), &refusal),
            Self::File(refusal, path) => {
                refused(py, format!("{}: {refusal}", path.display()), &refusal)
            }
            Self::Io {
                code,
                message,
                path,
                // With three arguments Python chooses the subclass, such as FileNotFoundError, by the number.
            } => PyOSError::new_err((code, message, path.into_os_string())),
        }
    }
}
