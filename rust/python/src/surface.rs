//! Surfaces for a plant: one surface, or a path with zones of surfaces.

use std::collections::BTreeMap;

use egp_plant::{ForceCurve, Friction, Surface, Uniform};
use pyo3::prelude::*;

use crate::error::{InvalidArgumentError, wrong_type};
use crate::path::Path;

/// A surface: a friction coefficient, the name of a preset, or a table of factors.
pub enum SurfaceValue {
    Friction(f64),
    Preset(String),
    Table(BTreeMap<String, f64>),
}

impl SurfaceValue {
    /// The surface of an object; `None` if the object is none of the three.
    fn of(object: Borrowed<'_, '_, PyAny>) -> Option<Self> {
        // The variants are tried in this order, and each failed attempt makes an exception: the usual ones come first.
        (object.extract().map(Self::Friction).ok())
            .or_else(|| object.extract().map(Self::Preset).ok())
            .or_else(|| object.extract().map(Self::Table).ok())
    }
}

impl FromPyObject<'_, '_> for SurfaceValue {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, '_, PyAny>) -> PyResult<Self> {
        Self::of(object).ok_or_else(|| wrong_type("surface", SURFACE, object))
    }
}

/// What a surface may be, in errors.
const SURFACE: &str = "a friction coefficient, the name of a surface or a table of its factors";

impl SurfaceValue {
    /// The surface, whose values may be out of range.
    ///
    /// # Errors
    /// An unknown preset, or a table without a peak or with an unknown field.
    pub fn surface(&self) -> PyResult<Surface> {
        match self {
            Self::Friction(mu) => Ok((*mu).into()),
            Self::Preset(name) => Surface::named(name).ok_or_else(|| {
                let known = Surface::PRESETS.map(|(name, _)| name).join(", ");
                InvalidArgumentError::new_err(format!("no surface {name:?}; known: {known}"))
            }),
            Self::Table(table) => from_table(table.clone()).map_err(InvalidArgumentError::new_err),
        }
    }
}

/// Peak, stiffness, shape and curvature of the longitudinal curve, the same of the lateral one, and the shift.
pub type SurfaceNumbers = [f64; 9];

/// All numbers of a surface, of which [`from_numbers`] makes it again.
pub fn numbers(surface: &Surface) -> SurfaceNumbers {
    let Surface {
        longitudinal: x,
        lateral: y,
        shift,
    } = surface;
    [
        x.peak,
        x.stiffness,
        x.shape,
        x.curvature,
        y.peak,
        y.stiffness,
        y.shape,
        y.curvature,
        *shift,
    ]
}

/// The surface of these numbers.
pub fn from_numbers(numbers: SurfaceNumbers) -> Surface {
    let [p_x, k_x, c_x, e_x, p_y, k_y, c_y, e_y, shift] = numbers;
    let curve = |peak, stiffness, shape, curvature| ForceCurve {
        peak,
        stiffness,
        shape,
        curvature,
    };
    Surface {
        longitudinal: curve(p_x, k_x, c_x, e_x),
        lateral: curve(p_y, k_y, c_y, e_y),
        shift,
    }
}

/// The surface of a table. Factors are 1 unless they are stated, and the lateral curve is that of [`Surface::new`].
fn from_table(mut table: BTreeMap<String, f64>) -> Result<Surface, String> {
    let peak =
        (table.remove("peak")).ok_or("a surface needs its `peak`, the friction coefficient")?;
    let mut factor = |name| table.remove(name).unwrap_or(1.0);
    let mut surface = Surface::new(
        peak,
        factor("stiffness"),
        factor("shape"),
        factor("curvature"),
    );
    let lateral = &mut surface.lateral;
    for (name, value) in [
        ("lateral_peak", &mut lateral.peak),
        ("lateral_stiffness", &mut lateral.stiffness),
        ("lateral_shape", &mut lateral.shape),
        ("lateral_curvature", &mut lateral.curvature),
    ] {
        *value = table.remove(name).unwrap_or(*value);
    }
    surface.shift = table.remove("shift").unwrap_or(surface.shift);
    match table.into_keys().next() {
        Some(unknown) => Err(format!(
            "unknown field `{unknown}` of a surface; known: peak, stiffness, shape, curvature, shift, \
             lateral_peak, lateral_stiffness, lateral_shape, lateral_curvature"
        )),
        None => Ok(surface),
    }
}

#[doc = doc!(surface_friction)]
#[pyfunction]
pub fn surface_friction(surface: SurfaceValue) -> PyResult<f64> {
    let surface = surface.surface()?;
    surface.validate().map_err(InvalidArgumentError::raise)?;
    Ok(surface.friction())
}

/// The `friction` argument of a step.
pub enum Road<'py> {
    Path(Bound<'py, Path>),
    Surface(SurfaceValue),
}

impl<'py> FromPyObject<'_, 'py> for Road<'py> {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if let Ok(path) = object.cast::<Path>() {
            return Ok(Self::Path(path.to_owned()));
        }
        SurfaceValue::of(object).map(Self::Surface).ok_or_else(|| {
            let expected = format!("a Path, {SURFACE}");
            wrong_type("friction", &expected, object)
        })
    }
}

impl Road<'_> {
    /// The surfaces for the plant; on a path the search for the first wheel starts at the arc length `hint`.
    ///
    /// # Errors
    /// Errors if the surface is unknown or out of range.
    pub fn friction(&self, hint: Option<f64>) -> PyResult<Box<dyn Friction + '_>> {
        Ok(match self {
            Self::Surface(value) => {
                let uniform = Uniform::new(value.surface()?);
                Box::new(uniform.map_err(InvalidArgumentError::raise)?)
            }
            Self::Path(path) => Box::new(path.get().0.surfaces_near(hint)),
        })
    }
}
