//! `SpeedProfile` and `horizon_reference`.

use egp_path::{HorizonRows, ReferenceStart, SpeedLimits};
use pyo3::prelude::*;

use crate::array::{Matrix, NewMatrix, NewVector, Vector, array, fixed, rows, vector};
use crate::error::InvalidArgumentError;
use crate::parameters::VehicleParameters;
use crate::path::{Path, check_arc_lengths};
use crate::projection::Projection;

/// Rows of the reference, rows of the widths if the path has any, and the projection.
type Reference<'py> = (NewMatrix<'py>, Option<NewMatrix<'py>>, Projection);

/// The rows `[mu, share]` of the argument `tyres`.
pub fn tyre_rows(tyres: Option<Matrix<'_>>) -> PyResult<Vec<[f64; 2]>> {
    tyres.map_or(Ok(Vec::new()), |tyres| rows("tyres", &tyres))
}

#[doc = doc!(SpeedProfile)]
#[pyclass(module = "egp_service._core", frozen)]
pub struct SpeedProfile(pub egp_path::SpeedProfile);

#[pymethods]
impl SpeedProfile {
    #[new]
    #[pyo3(signature = (
        path, vehicle, grip = 0.8, v_max = 30.0, *, start_speed = None, end_speed = None, tyres = None
    ))]
    #[allow(clippy::too_many_arguments)] // the limits of a profile
    fn new(
        py: Python<'_>,
        path: &Path,
        vehicle: &VehicleParameters,
        grip: f64,
        v_max: f64,
        start_speed: Option<f64>,
        end_speed: Option<f64>,
        tyres: Option<Matrix<'_>>,
    ) -> PyResult<Self> {
        let limits = SpeedLimits {
            grip,
            v_max,
            start_speed,
            end_speed,
            tyres: tyre_rows(tyres)?,
            ..SpeedLimits::of(&vehicle.0)
        };
        py.detach(|| egp_path::SpeedProfile::new(&path.0, &limits))
            .map(Self)
            .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(SpeedProfile.constant)]
    #[staticmethod]
    fn constant(path: &Path, speed: f64) -> PyResult<Self> {
        egp_path::SpeedProfile::constant(&path.0, speed)
            .map(Self)
            .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(SpeedProfile.lap_time)]
    #[getter]
    fn lap_time(&self) -> f64 {
        self.0.lap_time()
    }

    #[doc = doc!(SpeedProfile.speed)]
    fn speed<'py>(&self, py: Python<'py>, s: Vector<'py>) -> PyResult<NewVector<'py>> {
        check_arc_lengths(&s)?;
        Ok(vector(py, s.as_array().iter().map(|&s| self.0.speed(s))))
    }

    fn __repr__(&self) -> String {
        let (start, length, time) = (self.0.start(), self.0.length(), self.0.lap_time());
        let (least, most) = self.0.speed_range();
        format!(
            "SpeedProfile(start={start:.3}, length={length:.3}, lap_time={time:.3}, \
             slowest={least:.3}, fastest={most:.3})"
        )
    }
}

#[doc = doc!(horizon_reference)]
#[pyfunction]
#[pyo3(signature = (path, profile, x, dt, horizon, hint = None, *, catch_up = true))]
#[allow(clippy::too_many_arguments)] // the arguments are unrelated
pub fn horizon_reference<'py>(
    py: Python<'py>,
    path: &Path,
    profile: &SpeedProfile,
    x: Vector<'py>,
    dt: f64,
    horizon: u16,
    hint: Option<f64>,
    catch_up: bool,
) -> PyResult<Reference<'py>> {
    let [p_x, p_y, v_x, psi, ..] = fixed::<7>("x", &x)?;
    let start = ReferenceStart {
        position: [p_x, p_y],
        psi,
        catch_up_from: catch_up.then_some(v_x),
        hint,
    };
    let mut rows = HorizonRows::new(usize::from(horizon));
    let projection = egp_path::horizon_reference(&path.0, &profile.0, &start, dt, &mut rows)
        .map_err(InvalidArgumentError::raise)?;
    let (reference, widths) = rows.into_parts();
    let stages = reference.len();
    let widths = (path.0.has_widths())
        .then(|| array(py, widths.into_flattened(), [stages, 2]))
        .transpose()?;
    let reference = array(py, reference.into_flattened(), [stages, 4])?;
    Ok((reference, widths, projection.into()))
}
