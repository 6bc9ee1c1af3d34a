//! `Library` and `Member`.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use egp_core::gp::Hyperparameters;
use egp_core::library;
use egp_core::vehicle::{ModelParameters, Resistance, VehicleModel};
use egp_core::{GpInput, GpJacobian, NY, NZ, VarianceScratch};
use egp_engine::read_library;
use pyo3::exceptions::{PyIndexError, PyOSError};
use pyo3::prelude::*;

use crate::array::{Matrix, NewCube, NewMatrix, NewVector, array, rows, vector};
use crate::error::{InvalidArgumentError, LibraryError};
use crate::parameters::VehicleParameters;

/// Means, Jacobians and latent variances at a number of points.
type Prediction<'py> = (NewMatrix<'py>, NewCube<'py>, NewMatrix<'py>);

#[doc = doc!(Library)]
#[pyclass(module = "egp_service._core", frozen)]
pub struct Library(Arc<egp_core::Library>);

#[pymethods]
impl Library {
    #[doc = doc!(Library.load)]
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| {
            let bytes = read_library(&path).map_err(|error| os_error(&error, &path))?;
            egp_core::Library::from_bytes(&bytes).map_err(|refusal| Failure::File(refusal, path))
        })
        .map(|library| Self(Arc::new(library)))
        .map_err(|failure| failure.raise(py))
    }

    #[doc = doc!(Library.id)]
    #[getter]
    fn id(&self) -> String {
        library::hex(&self.0.id())
    }

    #[doc = doc!(Library.dt)]
    #[getter]
    fn dt(&self) -> f64 {
        self.0.dt()
    }

    #[doc = doc!(Library.kernel)]
    #[getter]
    fn kernel(&self) -> &'static str {
        self.0.kernel().name()
    }

    #[doc = doc!(Library.vehicle)]
    #[getter]
    fn vehicle(&self) -> &str {
        &self.0.metadata().vehicle
    }

    #[doc = doc!(Library.parameters)]
    #[getter]
    fn parameters(&self) -> VehicleParameters {
        VehicleParameters(*self.0.vehicle())
    }

    #[doc = doc!(Library.measurement_noise)]
    #[getter]
    fn measurement_noise<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        let noise = self.0.metadata().measurement_noise?;
        Some(vector(py, noise))
    }

    #[doc = doc!(Library.measurement_delay)]
    #[getter]
    fn measurement_delay(&self) -> Option<f64> {
        self.0.metadata().measurement_delay
    }

    #[doc = doc!(Library.provenance)]
    #[getter]
    fn provenance(&self) -> BTreeMap<String, String> {
        self.0.metadata().provenance.clone()
    }

    #[doc = doc!(Library.members)]
    #[getter]
    fn members(&self) -> Vec<Member> {
        (0..self.0.members().len())
            .map(|index| Member {
                library: self.0.clone(),
                index,
            })
            .collect()
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
        let members = self.0.members();
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

#[doc = doc!(Member)]
#[pyclass(module = "egp_service._core", frozen)]
pub struct Member {
    library: Arc<egp_core::Library>,
    index: usize,
}

impl Member {
    fn get(&self) -> &egp_core::Member {
        &self.library.members()[self.index]
    }

    fn each<'py>(&self, py: Python<'py>, value: fn(&Hyperparameters) -> f64) -> NewVector<'py> {
        vector(py, self.get().hyperparameters().iter().map(value))
    }
}

#[pymethods]
impl Member {
    #[doc = doc!(Member.label)]
    #[getter]
    fn label(&self) -> &str {
        self.get().label()
    }

    #[doc = doc!(Member.friction)]
    #[getter]
    fn friction(&self) -> f64 {
        self.get().friction()
    }

    #[doc = doc!(Member.peak_slip)]
    #[getter]
    fn peak_slip(&self) -> f64 {
        self.get().peak_slip(self.library.vehicle())
    }

    #[doc = doc!(Member.lateral_grip)]
    #[getter]
    fn lateral_grip(&self) -> f64 {
        self.get().lateral_grip(self.library.vehicle())
    }

    #[doc = doc!(Member.dataset)]
    #[getter]
    fn dataset(&self) -> &str {
        self.get().dataset()
    }

    #[doc = doc!(Member.n_points)]
    #[getter]
    fn n_points(&self) -> usize {
        self.get().n_points()
    }

    #[doc = doc!(Member.envelope)]
    #[getter]
    fn envelope<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        let (min, max) = self.get().envelope();
        array(py, min.iter().chain(max.iter()).copied().collect(), [2, NZ])
    }

    #[doc = doc!(Member.lengthscales)]
    #[getter]
    fn lengthscales<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        array(
            py,
            self.get()
                .hyperparameters()
                .iter()
                .flat_map(|hyper| hyper.lengthscales)
                .collect(),
            [NY, NZ],
        )
    }

    #[doc = doc!(Member.outputscale)]
    #[getter]
    fn outputscale<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.outputscale)
    }

    #[doc = doc!(Member.noise)]
    #[getter]
    fn noise<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.noise)
    }

    #[doc = doc!(Member.constant)]
    #[getter]
    fn constant<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.constant)
    }

    #[doc = doc!(Member.single_track)]
    #[getter]
    fn single_track<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        match self.get().vehicle()?.parameters() {
            ModelParameters::SingleTrack(parameters) => Some(vector(py, parameters)),
            ModelParameters::Kinematic(_) => None,
        }
    }

    #[doc = doc!(Member.euler_steps)]
    #[getter]
    fn euler_steps(&self) -> u32 {
        match self.get().vehicle() {
            Some(VehicleModel::SingleTrack(vehicle)) => vehicle.steps(),
            Some(VehicleModel::Kinematic(_)) | None => 1,
        }
    }

    #[doc = doc!(Member.resistance)]
    #[getter]
    fn resistance<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        match self.get().vehicle()? {
            VehicleModel::SingleTrack(vehicle) => {
                let Resistance { rolling, drag } = vehicle.resistance();
                Some(vector(py, [rolling, drag]))
            }
            VehicleModel::Kinematic(_) => None,
        }
    }

    #[doc = doc!(Member.kinematic)]
    #[getter]
    fn kinematic<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        match self.get().vehicle()?.parameters() {
            ModelParameters::Kinematic(parameters) => Some(vector(py, parameters)),
            ModelParameters::SingleTrack(_) => None,
        }
    }

    #[doc = doc!(Member.noise_std)]
    #[getter]
    fn noise_std<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.get().noise_std().iter().copied())
    }
}

/// An error while Python's lock was released.
pub enum Failure {
    Refused(library::LibraryError),
    /// What is wrong with the library in this file.
    File(library::LibraryError, PathBuf),
    Io {
        errno: Option<i32>,
        message: String,
        path: PathBuf,
    },
}

/// An error of the file system about `path`.
pub fn os_error(error: &io::Error, path: &Path) -> Failure {
    Failure::Io {
        errno: error.raw_os_error(),
        message: error.to_string(),
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
            // With three arguments Python chooses the subclass, such as FileNotFoundError, by the number.
            Self::Io {
                errno,
                message,
                path,
            } => PyOSError::new_err((errno, message, path)),
        }
    }
}
