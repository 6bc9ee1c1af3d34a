//! Surfaces for a plant: one surface, or a path with zones of surfaces.

use std::collections::BTreeMap;

use egp_plant::{Friction, Surface, Uniform};
use pyo3::prelude::*;

use crate::error::raise;
use crate::path::Path;

/// A surface: a friction coefficient, the name of a preset, or a table of factors.
#[derive(FromPyObject)]
pub enum SurfaceValue {
    Friction(f64),
    Preset(String),
    Table(BTreeMap<String, f64>),
}

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
                raise(format!("no surface {name:?}; known: {known}"))
            }),
            Self::Table(table) => from_table(table.clone()).map_err(raise),
        }
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
    surface.validate().map_err(raise)?;
    Ok(surface.friction())
}

/// The `friction` argument of a step.
#[derive(FromPyObject)]
pub enum Road<'py> {
    // The variants are tried in this order, and each failed attempt makes an exception: the usual ones come first.
    Friction(f64),
    Path(Bound<'py, Path>),
    Surface(SurfaceValue),
}

impl Road<'_> {
    /// The surfaces for the plant; on a path the search for the first wheel starts at the arc length `hint`.
    ///
    /// # Errors
    /// Errors if the surface is unknown or out of range.
    pub fn friction(&self, hint: Option<f64>) -> PyResult<Box<dyn Friction + '_>> {
        Ok(match self {
            Self::Friction(mu) => Box::new(Uniform::new(*mu).map_err(raise)?),
            Self::Surface(value) => Box::new(Uniform::new(value.surface()?).map_err(raise)?),
            Self::Path(path) => Box::new(path.get().0.surfaces_near(hint)),
        })
    }
}
