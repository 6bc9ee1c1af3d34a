//! `MemberData`, `write_library` and `write_library_subset`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use egp_core::library::{self, LibrarySpec};
use egp_core::vehicle::ModelParameters;
use egp_core::{Kernel, NY};
use egp_engine::read_library;
use egp_wire::replace_file;
use pyo3::prelude::*;

use crate::array::{Cube, Matrix, Vector, fixed, layers, rows, wrong_shape};
use crate::error::InvalidArgumentError;
use crate::failure::{Failure, os_error};
use crate::parameters::VehicleParameters;

/// One surface's vehicle and GPs, to be written into a file; M points, G golden points.
///
/// Inputs, targets, scalers, envelope and golden predictions are in physical units, everything else in the z-scored
/// space: `alpha = (K + noise I)^-1 (y - constant)` with z-scored `y`. The golden arrays hold the predictions of the
/// trainer's own implementation at a few points inside the data and a few far outside; loading must reproduce them.
///
/// Shapes: inputs (M, 6), targets (M, 3), input_mean and input_std (6,), target_mean and target_std (3,), lengthscales
/// (3, 6), outputscale, noise and constant (3,), alpha (3, M), envelope (2, 6), golden_z (G, 6), golden_mean (G, 3),
/// golden_jacobian (G, 3, 6), golden_variance (G, 3); `single_track` (17,) or `kinematic` (3,) as in `Member`, with
/// which targets and golden arrays include that vehicle's part and `y` is the rest of the targets; `resistance` (2,),
/// positive, of a single-track vehicle that has one, and `euler_steps`, the number of steps of the Euler method with which
/// a single-track vehicle predicts a period, 1 to 100.
///
/// A member with a vehicle may be a vehicle alone, with M = 0, any G, and the outputscale 0. Its variance is then that of
/// the noise.
#[pyclass(module = "egp_service._core", frozen)]
pub struct MemberData(library::MemberData);

#[pymethods]
impl MemberData {
    #[new]
    #[pyo3(signature = (
        *, label, friction, dataset, inputs, targets, input_mean, input_std, target_mean, target_std, lengthscales,
        outputscale, noise, constant, alpha, envelope, golden_z, golden_mean, golden_jacobian, golden_variance,
        single_track = None, kinematic = None, resistance = None, euler_steps = 1
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
        kinematic: Option<Vector<'_>>,
        resistance: Option<Vector<'_>>,
        euler_steps: u32,
    ) -> PyResult<Self> {
        let vehicle = match (single_track, kinematic) {
            (None, None) => None,
            (Some(p), None) => Some(ModelParameters::SingleTrack(fixed("single_track", &p)?)),
            (None, Some(p)) => Some(ModelParameters::Kinematic(fixed("kinematic", &p)?)),
            (Some(_), Some(_)) => {
                return Err(InvalidArgumentError::new_err(
                    "a member has one vehicle: give `single_track` or `kinematic`",
                ));
            }
        };
        if resistance.is_some() && !matches!(vehicle, Some(ModelParameters::SingleTrack(_))) {
            return Err(InvalidArgumentError::new_err(
                "`resistance` is that of a single-track vehicle: give `single_track`, too",
            ));
        }
        let resistance = resistance
            .map(|values| fixed("resistance", &values))
            .transpose()?;
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
            vehicle,
            resistance,
            euler_steps,
        }))
    }
}

/// A matrix with a known number of rows.
fn exactly<T, const N: usize>(name: &str, rows: Vec<T>) -> PyResult<[T; N]> {
    rows.try_into()
        .map_err(|rows: Vec<T>| wrong_shape(name, &format!("({N}, ...)"), &[rows.len()]))
}

/// Write a whole library file or nothing, after verifying that it can be loaded.
///
/// `dt` in s, `kernel` a name such as "matern52"; `vehicle` and `parameters` are name and parameters of the vehicle that the
/// data come from; `measurement_noise` (3,) are the standard deviations of the noise of the measured
/// `[v_x, v_y, omega]`, and `measurement_delay` the time in s by which these are late, if they are known. The same
/// arguments give the same bytes. Raises `InvalidArgumentError` for a number of these or a friction that is not finite,
/// `LibraryError` for other content that fails a check, and `OSError` if writing fails.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // all by name
#[pyo3(signature = (path, *, dt, kernel, vehicle, parameters, members, provenance, measurement_noise = None, measurement_delay = None))]
pub fn write_library(
    py: Python<'_>,
    path: PathBuf,
    dt: f64,
    kernel: &str,
    vehicle: String,
    parameters: &VehicleParameters,
    members: Vec<PyRef<'_, MemberData>>,
    provenance: BTreeMap<String, String>,
    measurement_noise: Option<Vector<'_>>,
    measurement_delay: Option<f64>,
) -> PyResult<()> {
    let unknown = || {
        Failure::Refused(library::LibraryError::UnknownKernel {
            found: kernel.to_owned(),
        })
        .raise(py)
    };
    let members: Vec<_> = members.iter().map(|member| member.0.clone()).collect();
    let measurement_noise: Option<[f64; NY]> = measurement_noise
        .map(|std| fixed("measurement_noise", &std))
        .transpose()?;
    // JSON, which holds these numbers in the file, has none that is not finite.
    let delay = measurement_delay.map(|delay| ("measurement_delay", delay));
    let noise = (measurement_noise.iter().flatten()).map(|std| ("measurement_noise", *std));
    let frictions = members
        .iter()
        .map(|member: &library::MemberData| ("friction", member.friction));
    let mut numbers = [("dt", dt)]
        .into_iter()
        .chain(delay)
        .chain(noise)
        .chain(frictions);
    if let Some((name, value)) = numbers.find(|(_, value)| !value.is_finite()) {
        let reason = format!("expected a finite number for {name}, got {value}");
        return Err(InvalidArgumentError::new_err(reason));
    }
    let spec = LibrarySpec {
        dt,
        kernel: Kernel::from_name(kernel).ok_or_else(unknown)?,
        vehicle,
        parameters: parameters.0,
        measurement_noise,
        measurement_delay,
        provenance,
        members,
    };
    py.detach(|| {
        let bytes = library::encode(&spec).map_err(Failure::Refused)?;
        replace_file(&path, &bytes).map_err(|error| os_error(&error, &path))
    })
    .map_err(|failure| failure.raise(py))
}

/// Write a library of some members (by index) of another one, with the same GPs bit for bit.
///
/// A member that is given more than once gets a number behind its label. Raises `LibraryError` if there is no such
/// member, `OSError` if reading or writing fails.
#[pyfunction]
pub fn write_library_subset(
    py: Python<'_>,
    source: PathBuf,
    path: PathBuf,
    members: Vec<usize>,
) -> PyResult<()> {
    py.detach(|| {
        let bytes = read_library(&source).map_err(|error| os_error(&error, &source))?;
        let bytes =
            library::subset(&bytes, &members).map_err(|refusal| Failure::File(refusal, source))?;
        replace_file(&path, &bytes).map_err(|error| os_error(&error, &path))
    })
    .map_err(|failure| failure.raise(py))
}
