//! `Library`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use egp_core::library;
use egp_core::{GpInput, GpJacobian, NY, NZ, VarianceScratch};
use egp_engine::read_library;
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyType};

use crate::array::{Matrix, NewCube, NewMatrix, NewVector, array, rows, vector};
use crate::error::InvalidArgumentError;
use crate::failure::{Failure, os_error};
use crate::member::Member;
use crate::parameters::VehicleParameters;
use crate::text::{list, quoted};

/// Means, Jacobians and latent variances at a number of points.
type Prediction<'py> = (NewMatrix<'py>, NewCube<'py>, NewMatrix<'py>);

#[doc = doc!(Library)]
#[pyclass(module = "egp_service._core", frozen)]
pub struct Library {
    pub inner: egp_core::Library,
    /// The bytes of the file, from which pickle makes the library again. They take much less memory than the factors.
    bytes: Py<PyBytes>,
}

#[pymethods]
impl Library {
    #[doc = doc!(Library.load)]
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let read = py.detach(|| {
            let bytes = read_library(&path).map_err(|error| os_error(&error, &path))?;
            let library = egp_core::Library::from_bytes(&bytes);
            let inner = library.map_err(|refusal| Failure::File(refusal, path))?;
            Ok((inner, bytes))
        });
        let (inner, bytes) = read.map_err(|failure: Failure| failure.raise(py))?;
        let bytes = PyBytes::new(py, &bytes).unbind();
        Ok(Self { inner, bytes })
    }

    /// The file's bytes, which pickle verifies and factors again.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (Py<PyBytes>,))> {
        let bytes = slf.get().bytes.clone_ref(slf.py());
        Ok((slf.get_type().getattr("_restore")?, (bytes,)))
    }

    /// The library of a file's bytes. Raises `LibraryError` if they fail a check.
    #[classmethod]
    fn _restore(cls: &Bound<'_, PyType>, bytes: Bound<'_, PyBytes>) -> PyResult<Self> {
        let (py, content) = (cls.py(), bytes.as_bytes());
        let inner = py
            .detach(|| egp_core::Library::from_bytes(content))
            .map_err(|refusal| Failure::Refused(refusal).raise(py))?;
        let bytes = bytes.unbind();
        Ok(Self { inner, bytes })
    }

    /// The library itself, which does not change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// The library itself, which does not change.
    #[pyo3(signature = (_memo, /))]
    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let labels: Vec<&str> = (self.inner.members().iter())
            .map(egp_core::Member::label)
            .collect();
        let (members, vehicle) = (list(py, &labels)?, quoted(py, self.vehicle())?);
        let (dt, kernel, id) = (self.dt(), self.kernel(), self.id());
        Ok(format!(
            "Library(members={members}, dt={dt:?}, kernel='{kernel}', vehicle={vehicle}, id='{id:.12}...')"
        ))
    }

    #[doc = doc!(Library.id)]
    #[getter]
    fn id(&self) -> String {
        library::hex(&self.inner.id())
    }

    #[doc = doc!(Library.dt)]
    #[getter]
    fn dt(&self) -> f64 {
        self.inner.dt()
    }

    #[doc = doc!(Library.kernel)]
    #[getter]
    fn kernel(&self) -> &'static str {
        self.inner.kernel().name()
    }

    #[doc = doc!(Library.vehicle)]
    #[getter]
    fn vehicle(&self) -> &str {
        &self.inner.metadata().vehicle
    }

    #[doc = doc!(Library.parameters)]
    #[getter]
    fn parameters(&self) -> VehicleParameters {
        VehicleParameters(*self.inner.vehicle())
    }

    #[doc = doc!(Library.measurement_noise)]
    #[getter]
    fn measurement_noise<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        let noise = self.inner.metadata().measurement_noise?;
        Some(vector(py, noise))
    }

    #[doc = doc!(Library.measurement_delay)]
    #[getter]
    fn measurement_delay(&self) -> Option<f64> {
        self.inner.metadata().measurement_delay
    }

    #[doc = doc!(Library.provenance)]
    #[getter]
    fn provenance(&self) -> BTreeMap<String, String> {
        self.inner.metadata().provenance.clone()
    }

    #[doc = doc!(Library.members)]
    #[getter]
    fn members(slf: &Bound<'_, Self>) -> Vec<Member> {
        (0..slf.get().inner.members().len())
            .map(|index| Member {
                library: slf.clone().unbind(),
                index,
            })
            .collect()
    }

    /// The member with this index. Pickle calls this to make a member again.
    #[pyo3(name = "_member")]
    fn member_at(slf: &Bound<'_, Self>, index: usize) -> PyResult<Member> {
        slf.get().member(index)?;
        let library = slf.clone().unbind();
        Ok(Member { library, index })
    }

    #[doc = doc!(Library.predict)]
    #[pyo3(signature = (z, member = 0))]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        z: Matrix<'py>,
        member: usize,
    ) -> PyResult<Prediction<'py>> {
        let member = self.member(member)?;
        let z = rows::<NZ>("z", &z)?;
        let n = z.len();
        check_finite(&z)?;
        let (means, jacobians, variances) = py.detach(|| predict(member, &z));
        check_overflow(&means)?;
        Ok((
            array(py, means, [n, NY])?,
            array(py, jacobians, [n, NY, NZ])?,
            array(py, variances, [n, NY])?,
        ))
    }

    #[doc = doc!(Library.predict_mean)]
    #[pyo3(signature = (z, member = 0))]
    fn predict_mean<'py>(
        &self,
        py: Python<'py>,
        z: Matrix<'py>,
        member: usize,
    ) -> PyResult<NewMatrix<'py>> {
        let member = self.member(member)?;
        let z = rows::<NZ>("z", &z)?;
        check_finite(&z)?;
        let mean = |z: &[f64; NZ]| <[f64; NY]>::from(member.mean(&GpInput::from(*z)));
        let means: Vec<f64> = py.detach(|| z.iter().flat_map(mean).collect());
        check_overflow(&means)?;
        array(py, means, [z.len(), NY])
    }
}

impl Library {
    fn member(&self, index: usize) -> PyResult<&egp_core::Member> {
        let members = self.inner.members();
        members.get(index).ok_or_else(|| {
            let count = members.len();
            PyIndexError::new_err(format!("member {index} of a library of {count}"))
        })
    }
}

/// Errors unless all inputs are finite.
fn check_finite(z: &[[f64; NZ]]) -> PyResult<()> {
    match z
        .iter()
        .position(|z| !z.iter().all(|value| value.is_finite()))
    {
        None => Ok(()),
        Some(row) => Err(InvalidArgumentError::new_err(format!(
            "expected finite inputs z, got {:?} in row {row}",
            z[row]
        ))),
    }
}

/// Errors if a prediction is not finite, because its input was too large.
fn check_overflow(means: &[f64]) -> PyResult<()> {
    match means.iter().position(|mean| !mean.is_finite()) {
        None => Ok(()),
        Some(index) => Err(InvalidArgumentError::new_err(format!(
            "the input in row {} of z is too large for a prediction: check its unit",
            index / NY
        ))),
    }
}

/// Row-major means, Jacobians and variances.
fn predict(member: &egp_core::Member, z: &[[f64; NZ]]) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let mut scratch = VarianceScratch::default();
    let mut jacobian = GpJacobian::zeros();
    let (mut means, mut jacobians, mut variances) = (Vec::new(), Vec::new(), Vec::new());
    for z in z {
        let z = GpInput::from(*z);
        means.extend(member.mean_jacobian(&z, &mut jacobian).iter());
        jacobians.extend(jacobian.transpose().iter());
        variances.extend(member.variance(&z, &mut scratch).iter());
    }
    (means, jacobians, variances)
}
