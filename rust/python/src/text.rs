//! Values as Python writes them, for `__repr__`.

use pyo3::prelude::*;
use pyo3::types::{PyList, PyString};

/// A truth value.
pub fn truth(value: bool) -> &'static str {
    if value { "True" } else { "False" }
}

/// A text in quotes.
pub fn quoted(py: Python<'_>, text: &str) -> PyResult<String> {
    Ok(PyString::new(py, text).repr()?.to_string())
}

/// A list of texts.
pub fn list(py: Python<'_>, texts: &[impl AsRef<str>]) -> PyResult<String> {
    let texts = texts.iter().map(AsRef::as_ref);
    Ok(PyList::new(py, texts)?.repr()?.to_string())
}
