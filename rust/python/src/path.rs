//! `Path`, `Projection`, `SpeedProfile` and `horizon_reference`.

use std::fmt::Display;
use std::fs;
use std::io::ErrorKind;
use std::path::PathBuf;

use egp_path::formats::read_track;
use egp_path::tracks::{
    Corner, DoubleLaneChange, LShape, LaneChanges, RandomTrack, RoundedRectangle,
};
use egp_path::{SpeedLimits, Zone};
use pyo3::prelude::*;

use crate::array::{Matrix, NewMatrix, NewVector, Vector, array, fixed, rows, vector};
use crate::error::{EgpError, InvalidArgumentError, raise};
use crate::parameters::VehicleParameters;
use crate::surface::SurfaceValue;

/// x, y, yaw, curvature, left, right, friction.
type Samples<'py> = (
    NewVector<'py>,
    NewVector<'py>,
    NewVector<'py>,
    NewVector<'py>,
    NewVector<'py>,
    NewVector<'py>,
    NewVector<'py>,
);
/// Rows of the reference, rows of the widths if the path has any, and the projection.
type Reference<'py> = (NewMatrix<'py>, Option<NewMatrix<'py>>, Projection);

/// Start and surface of a zone; a split zone has a surface to the left and one to the right.
#[derive(FromPyObject)]
enum ZoneTuple {
    Even(f64, SurfaceValue),
    Split(f64, SurfaceValue, SurfaceValue),
}

#[doc = doc!(Path)]
#[pyclass(module = "egp_service._core", frozen)]
pub struct Path(pub egp_path::Path);

#[pymethods]
impl Path {
    #[doc = doc!(Path.from_points)]
    #[staticmethod]
    #[pyo3(signature = (points, closed, widths = None))]
    fn from_points(
        py: Python<'_>,
        points: Matrix<'_>,
        closed: bool,
        widths: Option<Matrix<'_>>,
    ) -> PyResult<Self> {
        let points = rows("points", &points)?;
        let widths = widths.map(|widths| rows("widths", &widths)).transpose()?;
        // A long path takes a control period and more.
        py.detach(|| egp_path::Path::from_points(&points, closed, widths.as_deref()))
            .map(Self)
            .map_err(raise)
    }

    #[doc = doc!(Path.rounded_rectangle)]
    #[staticmethod]
    #[pyo3(signature = (length = 120.0, width = 60.0, radius = 15.0, transition = 10.0, track_width = 7.0))]
    fn rounded_rectangle(
        length: f64,
        width: f64,
        radius: f64,
        transition: f64,
        track_width: f64,
    ) -> PyResult<Self> {
        let corner = Corner { radius, transition };
        RoundedRectangle {
            length,
            width,
            corner,
            track_width,
        }
        .path()
        .map(Self)
        .map_err(raise)
    }

    #[doc = doc!(Path.l_shape)]
    #[staticmethod]
    #[pyo3(signature = (
        length = 130.0, width = 110.0, arm = 50.0, radius = 15.0, transition = 10.0, track_width = 7.0
    ))]
    fn l_shape(
        length: f64,
        width: f64,
        arm: f64,
        radius: f64,
        transition: f64,
        track_width: f64,
    ) -> PyResult<Self> {
        let corner = Corner { radius, transition };
        LShape {
            length,
            width,
            arm,
            corner,
            track_width,
        }
        .path()
        .map(Self)
        .map_err(raise)
    }

    #[doc = doc!(Path.iso_3888_2)]
    #[staticmethod]
    #[pyo3(signature = (vehicle_width, margin = 0.1, lead_in = 40.0, lead_out = 40.0))]
    fn iso_3888_2(vehicle_width: f64, margin: f64, lead_in: f64, lead_out: f64) -> PyResult<Self> {
        DoubleLaneChange {
            vehicle_width,
            margin,
            lead_in,
            lead_out,
        }
        .path()
        .map(Self)
        .map_err(raise)
    }

    #[doc = doc!(Path.lane_changes)]
    #[staticmethod]
    #[pyo3(signature = (length = 500.0, offset = 2.5, transition = 30.0, hold = 20.0, track_width = 7.0))]
    fn lane_changes(
        length: f64,
        offset: f64,
        transition: f64,
        hold: f64,
        track_width: f64,
    ) -> PyResult<Self> {
        LaneChanges {
            length,
            offset,
            transition,
            hold,
            track_width,
        }
        .path()
        .map(Self)
        .map_err(raise)
    }

    #[doc = doc!(Path.random)]
    #[staticmethod]
    #[pyo3(signature = (seed, length = 500.0, min_radius = 15.0, track_width = 7.0))]
    fn random(seed: u64, length: f64, min_radius: f64, track_width: f64) -> PyResult<Self> {
        RandomTrack {
            seed,
            length,
            min_radius,
            track_width,
        }
        .path()
        .map(Self)
        .map_err(raise)
    }

    #[doc = doc!(Path.from_csv)]
    #[staticmethod]
    #[pyo3(signature = (file, scale = 1.0))]
    fn from_csv(file: PathBuf, scale: f64) -> PyResult<Self> {
        let refuse = |error: &dyn Display| raise(format!("{}: {error}", file.display()));
        let text = fs::read_to_string(&file).map_err(|error| match error.kind() {
            ErrorKind::InvalidData => {
                refuse(&"this is no text in UTF-8; save the table as UTF-8, or give another file")
            }
            _ => refuse(&error),
        })?;
        read_track(&text, scale)
            .map(Self)
            .map_err(|error| refuse(&error))
    }

    #[doc = doc!(Path.with_friction)]
    fn with_friction(&self, zones: Vec<ZoneTuple>) -> PyResult<Self> {
        let zones: Vec<_> = zones
            .into_iter()
            .map(|zone| match zone {
                ZoneTuple::Even(start, surface) => Ok(Zone::new(start, surface.surface()?)),
                ZoneTuple::Split(start, surface, right) => Ok(Zone {
                    start,
                    surface: surface.surface()?,
                    right: Some(right.surface()?),
                }),
            })
            .collect::<PyResult<_>>()?;
        self.0
            .clone()
            .with_friction(&zones)
            .map(Self)
            .map_err(raise)
    }

    #[doc = doc!(Path.length)]
    #[getter]
    fn length(&self) -> f64 {
        self.0.length()
    }

    #[doc = doc!(Path.closed)]
    #[getter]
    fn closed(&self) -> bool {
        self.0.closed()
    }

    #[doc = doc!(Path.project)]
    #[pyo3(signature = (position, hint = None))]
    fn project(&self, position: Vector<'_>, hint: Option<f64>) -> PyResult<Projection> {
        let position = fixed("position", &position)?;
        if !position.into_iter().chain(hint).all(f64::is_finite) {
            return Err(EgpError::new_err(format!(
                "expected a finite position and hint, got {position:?} and {hint:?}"
            )));
        }
        Ok(self.0.project(position, hint).into())
    }

    #[doc = doc!(Path.sample)]
    fn sample<'py>(&self, py: Python<'py>, s: Vector<'py>) -> PyResult<Samples<'py>> {
        check_arc_lengths(&s)?;
        let samples: Vec<_> = s.as_array().iter().map(|&s| self.0.sample(s)).collect();
        let column = |value: fn(&egp_path::Sample) -> f64| vector(py, samples.iter().map(value));
        Ok((
            column(|at| at.x),
            column(|at| at.y),
            column(|at| at.yaw),
            column(|at| at.curvature),
            column(|at| at.left),
            column(|at| at.right),
            column(|at| at.friction),
        ))
    }
}

#[doc = doc!(Projection)]
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct Projection {
    #[doc = doc!(Projection.s)]
    s: f64,
    #[doc = doc!(Projection.lateral)]
    lateral: f64,
    #[doc = doc!(Projection.x)]
    x: f64,
    #[doc = doc!(Projection.y)]
    y: f64,
    #[doc = doc!(Projection.yaw)]
    yaw: f64,
    #[doc = doc!(Projection.curvature)]
    curvature: f64,
    #[doc = doc!(Projection.left)]
    left: f64,
    #[doc = doc!(Projection.right)]
    right: f64,
    #[doc = doc!(Projection.friction)]
    friction: f64,
}

impl From<egp_path::Projection> for Projection {
    fn from(projection: egp_path::Projection) -> Self {
        let egp_path::Projection { s, lateral, sample } = projection;
        Self {
            s,
            lateral,
            x: sample.x,
            y: sample.y,
            yaw: sample.yaw,
            curvature: sample.curvature,
            left: sample.left,
            right: sample.right,
            friction: sample.friction,
        }
    }
}

#[pymethods]
impl Projection {
    fn __repr__(&self) -> String {
        let Self {
            s, lateral, yaw, ..
        } = self;
        format!("Projection(s={s:.3}, lateral={lateral:.3}, yaw={yaw:.4})")
    }
}

/// Errors unless all arc lengths of the argument `s` are finite.
fn check_arc_lengths(s: &Vector<'_>) -> PyResult<()> {
    let s = s.as_array();
    match s.iter().position(|s| !s.is_finite()) {
        None => Ok(()),
        Some(index) => Err(InvalidArgumentError::new_err(format!(
            "expected finite arc lengths s, got {} at index {index}",
            s[index]
        ))),
    }
}

/// The rows `[mu, share]` of the argument `tyres`.
pub fn tyre_rows(tyres: Option<Matrix<'_>>) -> PyResult<Vec<[f64; 2]>> {
    tyres.map_or(Ok(Vec::new()), |tyres| rows("tyres", &tyres))
}

#[doc = doc!(SpeedProfile)]
#[pyclass(module = "egp_service._core", frozen)]
pub struct SpeedProfile(pub egp_path::SpeedProfile);

impl SpeedProfile {
    pub fn of(profile: egp_path::SpeedProfile) -> Self {
        Self(profile)
    }
}

#[pymethods]
impl SpeedProfile {
    #[new]
    #[pyo3(signature = (
        path, vehicle, grip = 0.8, v_max = 30.0, *, start_speed = None, end_speed = None, tyres = None
    ))]
    fn new(
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
        egp_path::SpeedProfile::new(&path.0, &limits)
            .map(Self)
            .map_err(raise)
    }

    #[doc = doc!(SpeedProfile.constant)]
    #[staticmethod]
    fn constant(path: &Path, speed: f64) -> PyResult<Self> {
        egp_path::SpeedProfile::constant(&path.0, speed)
            .map(Self)
            .map_err(raise)
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
    let stages = usize::from(horizon) + 1;
    let mut reference = vec![[0.0; 4]; stages];
    let mut widths = vec![[0.0; 2]; stages];
    let projection = egp_path::horizon_reference(
        &path.0,
        &profile.0,
        [p_x, p_y],
        psi,
        dt,
        hint,
        &mut reference,
        &mut widths,
    )
    .map_err(raise)?;
    if catch_up {
        let (rows, edges) = (&mut reference, &mut widths);
        egp_path::catch_up(&path.0, &profile.0, projection.s, v_x, dt, rows, edges);
    }
    let widths = (path.0.has_widths())
        .then(|| array(py, widths.into_flattened(), [stages, 2]))
        .transpose()?;
    let reference = array(py, reference.into_flattened(), [stages, 4])?;
    Ok((reference, widths, projection.into()))
}
