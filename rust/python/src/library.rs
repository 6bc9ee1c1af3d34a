//! `Library`, `Member`, `MemberData` and `write_library`.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use egp_core::gp::Hyperparameters;
use egp_core::library::{self, LibrarySpec, MAX_FILE_BYTES};
use egp_core::{GpInput, GpJacobian, Kernel, NY, NZ, VarianceScratch};
use pyo3::create_exception;
use pyo3::exceptions::{PyIndexError, PyOSError};
use pyo3::prelude::*;

use crate::array::{Cube, Matrix, NewCube, NewMatrix, NewVector, Vector};
use crate::array::{array, fixed, layers, rows, vector, wrong_shape};
use crate::error::EgpError;

create_exception!(
    egp_service._core,
    LibraryError,
    EgpError,
    "A refused library file; `code` names the kind of refusal, the message says what to do next."
);

/// Means, Jacobians and latent variances at a number of points.
type Prediction<'py> = (NewMatrix<'py>, NewCube<'py>, NewMatrix<'py>);

/// A verified library.
#[pyclass(module = "egp_service._core", frozen)]
struct Library(Arc<egp_core::Library>);

#[pymethods]
impl Library {
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| {
            let bytes = read(&path).map_err(|error| os_error(&error, &path))?;
            egp_core::Library::from_bytes(&bytes).map_err(Failure::Refused)
        })
        .map(|library| Self(Arc::new(library)))
        .map_err(|failure| failure.raise(py))
    }

    #[getter]
    fn id(&self) -> String {
        library::hex(&self.0.id())
    }

    #[getter]
    fn dt(&self) -> f64 {
        self.0.dt()
    }

    #[getter]
    fn kernel(&self) -> &'static str {
        self.0.kernel().name()
    }

    #[getter]
    fn vehicle(&self) -> &str {
        &self.0.metadata().vehicle
    }

    #[getter]
    fn provenance(&self) -> BTreeMap<String, String> {
        self.0.metadata().provenance.clone()
    }

    #[getter]
    fn members(&self) -> Vec<Member> {
        (0..self.0.members().len())
            .map(|index| Member {
                library: self.0.clone(),
                index,
            })
            .collect()
    }

    #[pyo3(signature = (z, member = 0))]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        z: Matrix<'py>,
        member: usize,
    ) -> PyResult<Prediction<'py>> {
        let Some(member) = self.0.members().get(member) else {
            let count = self.0.members().len();
            return Err(PyIndexError::new_err(format!(
                "member {member} of a library of {count}"
            )));
        };
        let z = rows::<NZ>("z", &z)?;
        let n = z.len();
        let (means, jacobians, variances) = py.detach(|| predict(member, &z));
        Ok((
            array(py, means, [n, NY])?,
            array(py, jacobians, [n, NY, NZ])?,
            array(py, variances, [n, NY])?,
        ))
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

/// One surface's GPs inside a library.
#[pyclass(module = "egp_service._core", frozen)]
struct Member {
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
    #[getter]
    fn label(&self) -> &str {
        self.get().label()
    }

    #[getter]
    fn friction(&self) -> f64 {
        self.get().friction()
    }

    #[getter]
    fn dataset(&self) -> &str {
        self.get().dataset()
    }

    #[getter]
    fn n_points(&self) -> usize {
        self.get().n_points()
    }

    #[getter]
    fn envelope<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        let (min, max) = self.get().envelope();
        array(py, min.iter().chain(max.iter()).copied().collect(), [2, NZ])
    }

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

    #[getter]
    fn outputscale<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.outputscale)
    }

    #[getter]
    fn noise<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.noise)
    }

    #[getter]
    fn constant<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        self.each(py, |hyper| hyper.constant)
    }

    #[getter]
    fn single_track<'py>(&self, py: Python<'py>) -> Option<NewVector<'py>> {
        let known = self.get().single_track()?;
        Some(vector(py, known.parameters().iter().copied()))
    }

    #[getter]
    fn noise_std<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.get().noise_std().iter().copied())
    }
}

/// One surface's GPs on their way into a file.
#[pyclass(module = "egp_service._core", frozen)]
struct MemberData(library::MemberData);

#[pymethods]
impl MemberData {
    #[new]
    #[pyo3(signature = (
        *, label, friction, dataset, inputs, targets, input_mean, input_std, target_mean, target_std, lengthscales,
        outputscale, noise, constant, alpha, envelope, golden_z, golden_mean, golden_jacobian, golden_variance,
        single_track = None
    ))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        label: String,
        friction: f64,
        dataset: String,
        inputs: Matrix<'_>,
        targets: Matrix<'_>,
        input_mean: Vector<'_>,
        input_std: Vector<'_>,
        target_mean: Vector<'_>,
        target_std: Vector<'_>,
        lengthscales: Matrix<'_>,
        outputscale: Vector<'_>,
        noise: Vector<'_>,
        constant: Vector<'_>,
        alpha: Matrix<'_>,
        envelope: Matrix<'_>,
        golden_z: Matrix<'_>,
        golden_mean: Matrix<'_>,
        golden_jacobian: Cube<'_>,
        golden_variance: Matrix<'_>,
        single_track: Option<Vector<'_>>,
    ) -> PyResult<Self> {
        Ok(Self(library::MemberData {
            label,
            friction,
            dataset,
            inputs: rows("inputs", &inputs)?,
            targets: rows("targets", &targets)?,
            input_mean: fixed("input_mean", &input_mean)?,
            input_std: fixed("input_std", &input_std)?,
            target_mean: fixed("target_mean", &target_mean)?,
            target_std: fixed("target_std", &target_std)?,
            lengthscales: exactly("lengthscales", rows("lengthscales", &lengthscales)?)?,
            outputscale: fixed("outputscale", &outputscale)?,
            noise: fixed("noise", &noise)?,
            constant: fixed("constant", &constant)?,
            alpha: exactly(
                "alpha",
                alpha
                    .as_array()
                    .rows()
                    .into_iter()
                    .map(|row| row.to_vec())
                    .collect(),
            )?,
            envelope: exactly("envelope", rows("envelope", &envelope)?)?,
            golden_z: rows("golden_z", &golden_z)?,
            golden_mean: rows("golden_mean", &golden_mean)?,
            golden_jacobian: layers("golden_jacobian", &golden_jacobian)?,
            golden_variance: rows("golden_variance", &golden_variance)?,
            single_track: single_track
                .map(|parameters| fixed("single_track", &parameters))
                .transpose()?,
        }))
    }
}

/// A matrix with a known number of rows.
fn exactly<T, const N: usize>(name: &str, rows: Vec<T>) -> PyResult<[T; N]> {
    rows.try_into()
        .map_err(|rows: Vec<T>| wrong_shape(name, &format!("({N}, ...)"), &[rows.len()]))
}

#[pyfunction]
#[pyo3(signature = (path, *, dt, kernel, vehicle, members, provenance))]
fn write_library(
    py: Python<'_>,
    path: PathBuf,
    dt: f64,
    kernel: &str,
    vehicle: String,
    members: Vec<PyRef<'_, MemberData>>,
    provenance: BTreeMap<String, String>,
) -> PyResult<()> {
    let unknown = || {
        Failure::Refused(library::LibraryError::UnknownKernel {
            found: kernel.to_owned(),
        })
        .raise(py)
    };
    let members = members.iter().map(|member| member.0.clone()).collect();
    let spec = LibrarySpec {
        dt,
        kernel: Kernel::from_name(kernel).ok_or_else(unknown)?,
        vehicle,
        provenance,
        members,
    };
    py.detach(|| {
        let bytes = library::encode(&spec).map_err(Failure::Refused)?;
        replace(&path, &bytes).map_err(|error| os_error(&error, &path))
    })
    .map_err(|failure| failure.raise(py))
}

#[pyfunction]
fn write_library_subset(
    py: Python<'_>,
    source: PathBuf,
    path: PathBuf,
    members: Vec<usize>,
) -> PyResult<()> {
    py.detach(|| {
        let bytes = read(&source).map_err(|error| os_error(&error, &source))?;
        let bytes = library::subset(&bytes, &members).map_err(Failure::Refused)?;
        replace(&path, &bytes).map_err(|error| os_error(&error, &path))
    })
    .map_err(|failure| failure.raise(py))
}

/// The bytes of a file, no more than a library may have (and one, so that the excess shows).
fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?
        .take(MAX_FILE_BYTES as u64 + 1)
        .read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Puts a file in place as a whole: whoever reads the path finds the old bytes or the new ones, also after a crash.
fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.tmp", std::process::id()));
    let beside = path.with_file_name(name);
    let written = (|| {
        let mut file = File::create(&beside)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&beside, path)
    })();
    if written.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&beside);
        return written;
    }
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

/// What went wrong while Python's lock was released.
enum Failure {
    Refused(library::LibraryError),
    Io {
        errno: Option<i32>,
        message: String,
        path: PathBuf,
    },
}

fn os_error(error: &io::Error, path: &Path) -> Failure {
    Failure::Io {
        errno: error.raw_os_error(),
        message: error.to_string(),
        path: path.to_owned(),
    }
}

impl Failure {
    fn raise(self, py: Python<'_>) -> PyErr {
        match self {
            Self::Refused(refusal) => {
                let error = LibraryError::new_err(refusal.to_string());
                match error.value(py).setattr("code", refusal.code()) {
                    Ok(()) => error,
                    Err(error) => error,
                }
            }
            // With three arguments Python picks the subclass, such as FileNotFoundError, by the number.
            Self::Io {
                errno,
                message,
                path,
            } => PyOSError::new_err((errno, message, path)),
        }
    }
}

/// Adds this file's classes and functions to the module.
///
/// # Errors
/// When Python refuses one.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("LibraryError", module.py().get_type::<LibraryError>())?;
    module.add_class::<Library>()?;
    module.add_class::<Member>()?;
    module.add_class::<MemberData>()?;
    module.add_function(wrap_pyfunction!(write_library, module)?)?;
    module.add_function(wrap_pyfunction!(write_library_subset, module)?)
}
