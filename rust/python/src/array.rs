//! numpy arrays of known shape as Rust arrays, and back.

use std::ops::Deref;

use numpy::ndarray::{ArrayD, ArrayViewD, Dimension, IntoDimension, Ix1, Ix2, Ix3, IxDyn};
use numpy::{AllowTypeChange, Element, IntoPyArray, PyArrayLike, PyReadonlyArray};
use numpy::{
    PyArray, PyArray1, PyArray2, PyArray3, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods,
};
use numpy::{PyUntypedArray, PyUntypedArrayMethods, get_array_module};
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;

use crate::error::InvalidArgumentError;

/// An array of `f64` from Python as it is, or what numpy makes of lists and of numbers of another type.
///
/// Anything else is an `InvalidArgumentError`, to which `PyO3` adds a note with the name of the argument.
pub struct Argument<'py, D: Dimension>(PyArrayLike<'py, f64, D, AllowTypeChange>);

impl<'py, D: Dimension> Deref for Argument<'py, D> {
    type Target = PyReadonlyArray<'py, f64, D>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl<'a, 'py, D: Dimension + 'py> FromPyObject<'a, 'py> for Argument<'py, D> {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let expected = match D::NDIM {
            Some(1) => "an array of numbers with 1 dimension".to_owned(),
            Some(count) => format!("an array of numbers with {count} dimensions"),
            None => "an array of numbers".to_owned(),
        };
        let wrong = |found: String| {
            InvalidArgumentError::new_err(format!("expected {expected}, got {found}"))
        };
        let py = object.py();
        let array = match object.cast::<PyUntypedArray>() {
            Ok(array) => array.to_owned(),
            Err(_) => get_array_module(py)?
                .call_method1(intern!(py, "asarray"), (object,))
                .and_then(|made| Ok(made.cast_into::<PyUntypedArray>()?))
                .map_err(|error| {
                    // Others, such as an interruption by a signal, say nothing about the argument.
                    let of_argument = error.is_instance_of::<PyTypeError>(py)
                        || error.is_instance_of::<PyValueError>(py)
                        || error.is_instance_of::<PyOverflowError>(py);
                    if !of_argument {
                        return error;
                    }
                    let kind = object.get_type().name();
                    kind.map_or_else(
                        |error| error,
                        |kind| wrong(format!("{kind}: {}", error.value(py))),
                    )
                })?,
        };
        // numpy would leave out the imaginary part of a complex number, read texts as numbers, and `None` as NaN.
        if !b"biuf".contains(&array.dtype().kind()) {
            return Err(wrong(format!("the type {}", array.dtype())));
        }
        let extracted = array.extract();
        extracted
            .map(Self)
            .map_err(|_| wrong(format!("the shape {}", shown(array.shape()))))
    }
}

/// A vector from Python.
pub type Vector<'py> = Argument<'py, Ix1>;
/// A matrix from Python.
pub type Matrix<'py> = Argument<'py, Ix2>;
/// A three-dimensional array from Python.
pub type Cube<'py> = Argument<'py, Ix3>;
/// An array of any dimension from Python.
pub type ArrayLike<'py> = Argument<'py, IxDyn>;
/// An array of any dimension.
pub type OwnedArray = ArrayD<f64>;
/// A view of an array of any dimension.
pub type ArrayView<'a> = ArrayViewD<'a, f64>;
/// A vector for Python.
pub type NewVector<'py, T = f64> = Bound<'py, PyArray1<T>>;
/// A matrix for Python.
pub type NewMatrix<'py> = Bound<'py, PyArray2<f64>>;
/// An array of any dimension for Python.
pub type NewArray<'py> = Bound<'py, PyArrayDyn<f64>>;
/// A three-dimensional array for Python.
pub type NewCube<'py> = Bound<'py, PyArray3<f64>>;

/// A vector of `N` numbers.
///
/// # Errors
/// Errors if the array has another length.
pub fn fixed<const N: usize>(name: &str, array: &Vector<'_>) -> PyResult<[f64; N]> {
    let array = array.as_array();
    if array.len() == N {
        return Ok(std::array::from_fn(|i| array[i]));
    }
    Err(wrong_shape(name, &format!("({N},)"), &[array.len()]))
}

/// The rows of a matrix with `N` columns.
///
/// # Errors
/// Errors if the matrix has another number of columns.
pub fn rows<const N: usize>(name: &str, array: &Matrix<'_>) -> PyResult<Vec<[f64; N]>> {
    let array = array.as_array();
    if array.ncols() == N {
        return Ok(array
            .rows()
            .into_iter()
            .map(|row| std::array::from_fn(|i| row[i]))
            .collect());
    }
    Err(wrong_shape(name, &format!("(n, {N})"), array.shape()))
}

/// The layers of an `(n, R, C)` array.
///
/// # Errors
/// Errors if the layers have other sizes.
pub fn layers<const R: usize, const C: usize>(
    name: &str,
    array: &Cube<'_>,
) -> PyResult<Vec<[[f64; C]; R]>> {
    let array = array.as_array();
    if array.shape()[1..] != [R, C] {
        return Err(wrong_shape(name, &format!("(n, {R}, {C})"), array.shape()));
    }
    let layer =
        |layer: usize| std::array::from_fn(|r| std::array::from_fn(|c| array[[layer, r, c]]));
    Ok((0..array.shape()[0]).map(layer).collect())
}

/// A vector that a Python object keeps.
pub type KeptVector = Py<PyArray1<f64>>;
/// A matrix that a Python object keeps.
pub type KeptMatrix = Py<PyArray2<f64>>;
/// A three-dimensional array that a Python object keeps.
pub type KeptCube = Py<PyArray3<f64>>;

/// A numpy vector of these numbers.
pub fn vector<T: Element>(py: Python<'_>, values: impl IntoIterator<Item = T>) -> NewVector<'_, T> {
    PyArray1::from_iter(py, values)
}

/// A numpy array of that shape from numbers in row-major order.
///
/// # Errors
/// Errors if the count does not match the shape.
pub fn array<S: IntoDimension>(
    py: Python<'_>,
    values: Vec<f64>,
    shape: S,
) -> PyResult<Bound<'_, PyArray<f64, S::Dim>>> {
    values.into_pyarray(py).reshape(shape)
}

/// A copy of an array for Python, which a caller may change.
pub fn copied<'py>(py: Python<'py>, array: &OwnedArray) -> NewArray<'py> {
    array.clone().into_pyarray(py)
}

/// Number of rows of a matrix that a Python object keeps.
pub fn row_count(py: Python<'_>, matrix: &KeptMatrix) -> usize {
    matrix.bind(py).dims()[0]
}

/// The first number that is not finite, with its indices.
pub fn not_finite(array: ArrayView<'_>) -> Option<(Vec<usize>, f64)> {
    let mut numbers = array.indexed_iter();
    let (index, number) = numbers.find(|(_, number)| !number.is_finite())?;
    Some((index.slice().to_vec(), *number))
}

/// The error about an array of the wrong shape, written as Python writes shapes.
pub fn wrong_shape(name: &str, expected: &str, found: &[usize]) -> PyErr {
    let found = shown(found);
    InvalidArgumentError::new_err(format!("expected {name} of shape {expected}, got {found}"))
}

/// A shape as Python writes it.
pub fn shown(shape: &[usize]) -> String {
    match shape {
        [count] => format!("({count},)"),
        _ => format!("{shape:?}").replace('[', "(").replace(']', ")"),
    }
}
