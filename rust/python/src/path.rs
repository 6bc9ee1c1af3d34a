//! `Path`.

use std::fmt::Display;
use std::io::ErrorKind;
use std::path::PathBuf;

use egp_parameters::OutOfRange;
use egp_path::formats::read_track;
use egp_path::tracks::{
    Corner, DoubleLaneChange, LShape, LaneChanges, RandomTrack, RoundedRectangle,
};
use egp_path::{PathError, PathParts, Zone};
use egp_wire::read_text;
use pyo3::prelude::*;
use pyo3::types::PyType;

use crate::array::{Cube, Matrix, NewCube, NewMatrix, NewVector, Vector};
use crate::array::{array, fixed, layers, rows, vector};
use crate::error::{InvalidArgumentError, raise, system_text};
use crate::projection::Projection;
use crate::surface::{SurfaceNumbers, SurfaceValue, from_numbers, numbers};
use crate::text::truth;

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

/// The zone of a row `(start, surface)`, or of `(start, left, right)` on a split road; `None` for anything else.
fn zone(row: &Bound<'_, PyAny>) -> Option<(f64, SurfaceValue, Option<SurfaceValue>)> {
    let row: Vec<Bound<'_, PyAny>> = row.try_iter().ok()?.collect::<PyResult<_>>().ok()?;
    let (start, surface, right) = match row.as_slice() {
        [start, surface] => (start, surface, None),
        [start, left, right] => (start, left, Some(right.extract().ok()?)),
        _ => return None,
    };
    Some((start.extract().ok()?, surface.extract().ok()?, right))
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
            .map_err(InvalidArgumentError::raise)
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
        .map_err(InvalidArgumentError::raise)
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
        .map_err(InvalidArgumentError::raise)
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
        .map_err(InvalidArgumentError::raise)
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
        .map_err(InvalidArgumentError::raise)
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
        .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(Path.from_csv)]
    #[staticmethod]
    #[pyo3(signature = (file, scale = 1.0, closed = true))]
    fn from_csv(py: Python<'_>, file: PathBuf, scale: f64, closed: bool) -> PyResult<Self> {
        let refuse = |error: &dyn Display| raise(format!("{}: {error}", file.display()));
        let text = py
            .detach(|| read_text(&file))
            .map_err(|error| match error.kind() {
                ErrorKind::InvalidData => refuse(&format!(
                    "{error}; save the table in this form, or give another file"
                )),
                ErrorKind::InvalidInput => refuse(&error),
                _ => refuse(&system_text(&error)),
            })?;
        py.detach(|| read_track(&text, scale, closed))
            .map(Self)
            .map_err(|error| match error {
                PathError::Parameter(OutOfRange { name: "scale", .. }) => {
                    InvalidArgumentError::raise(error)
                }
                _ => refuse(&error),
            })
    }

    #[doc = doc!(Path.with_friction)]
    fn with_friction(&self, py: Python<'_>, zones: &Bound<'_, PyAny>) -> PyResult<Self> {
        let wrong = |found: &Bound<'_, PyAny>| {
            InvalidArgumentError::new_err(format!(
                "zones: expected rows (start, friction), or (start, left, right) on a split road, got {found:?}"
            ))
        };
        let mut checked = Vec::new();
        for row in zones.try_iter().map_err(|_| wrong(zones))? {
            let row = row?;
            let (start, surface, right) = zone(&row).ok_or_else(|| wrong(&row))?;
            checked.push(Zone {
                start,
                surface: surface.surface()?,
                right: right.map(|right| right.surface()).transpose()?,
            });
        }
        py.detach(|| self.0.clone().with_friction(&checked))
            .map(Self)
            .map_err(InvalidArgumentError::raise)
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
        let position: [f64; 2] = fixed("position", &position)?;
        if !position.into_iter().all(f64::is_finite) {
            let reason = format!("expected a finite position, got {position:?}");
            return Err(InvalidArgumentError::new_err(reason));
        }
        check_hint(hint)?;
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

    /// The numbers that the path consists of, from which pickle makes the same path again, bit for bit.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Parts<'py>)> {
        let py = slf.py();
        let parts = slf.get().0.parts();
        let count = parts.pieces.len();
        let pieces = parts.pieces.into_flattened().into_flattened();
        let widths = parts.widths.map(|widths| {
            let knots = widths.len();
            array(py, widths.into_flattened(), [knots, 2])
        });
        let zones = parts.zones.iter().map(|zone| {
            let right = zone.right.as_ref().map(numbers);
            (zone.start, numbers(&zone.surface), right)
        });
        let parts = (
            parts.closed,
            parts.step,
            array(py, pieces, [count, 2, 4])?,
            widths.transpose()?,
            zones.collect(),
        );
        Ok((slf.get_type().getattr("_restore")?, parts))
    }

    /// The path of the numbers of `__reduce__`. Raises `InvalidArgumentError` if no path consists of these numbers.
    #[classmethod]
    fn _restore(
        cls: &Bound<'_, PyType>,
        closed: bool,
        step: f64,
        pieces: Cube<'_>,
        widths: Option<Matrix<'_>>,
        zones: Vec<ZoneNumbers>,
    ) -> PyResult<Self> {
        let zones = zones.into_iter().map(|(start, surface, right)| Zone {
            start,
            surface: from_numbers(surface),
            right: right.map(from_numbers),
        });
        let parts = PathParts {
            closed,
            step,
            pieces: layers("pieces", &pieces)?,
            widths: widths.map(|widths| rows("widths", &widths)).transpose()?,
            zones: zones.collect(),
        };
        cls.py()
            .detach(|| egp_path::Path::from_parts(parts))
            .map(Self)
            .map_err(InvalidArgumentError::raise)
    }

    /// The path itself, which does not change.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// The path itself, which does not change.
    #[pyo3(signature = (_memo, /))]
    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn __repr__(&self) -> String {
        let (length, closed) = (self.0.length(), truth(self.0.closed()));
        format!("Path(length={length:.3}, closed={closed})")
    }
}

/// Start of a zone, its surface, and that to the right of the path on a split road.
type ZoneNumbers = (f64, SurfaceNumbers, Option<SurfaceNumbers>);

/// The numbers of a path: whether it is closed, the step, the pieces (n, 2, 4), the widths (knots, 2), and the zones.
type Parts<'py> = (
    bool,
    f64,
    NewCube<'py>,
    Option<NewMatrix<'py>>,
    Vec<ZoneNumbers>,
);

/// Errors unless the argument `hint` is finite, if it is given.
pub fn check_hint(hint: Option<f64>) -> PyResult<()> {
    match hint {
        Some(hint) if !hint.is_finite() => Err(InvalidArgumentError::new_err(format!(
            "expected a finite hint, got {hint}"
        ))),
        _ => Ok(()),
    }
}

/// Errors unless all arc lengths of the argument `s` are finite.
pub fn check_arc_lengths(s: &Vector<'_>) -> PyResult<()> {
    let s = s.as_array();
    match s.iter().position(|s| !s.is_finite()) {
        None => Ok(()),
        Some(index) => Err(InvalidArgumentError::new_err(format!(
            "expected finite arc lengths s, got {} at index {index}",
            s[index]
        ))),
    }
}
