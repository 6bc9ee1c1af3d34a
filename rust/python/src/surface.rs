//! Surfaces for a plant: a coefficient, a map, or a path with friction zones.

use std::cell::Cell;

use egp_plant::{Friction, Map, Uniform};
use pyo3::prelude::*;

use crate::array::Matrix;
use crate::error::raise;
use crate::path::Path;

#[doc = doc!(FrictionMap)]
#[pyclass(module = "egp_service._core", frozen)]
pub struct FrictionMap(Map);

#[pymethods]
impl FrictionMap {
    #[new]
    fn new(values: Matrix<'_>, origin: (f64, f64), cell: f64) -> PyResult<Self> {
        let values = values.as_array();
        let (rows, columns) = values.dim();
        let values = values.iter().copied().collect();
        Map::new([origin.0, origin.1], cell, [rows, columns], values)
            .map(Self)
            .map_err(raise)
    }
}

/// The `friction` argument of a step.
#[derive(FromPyObject)]
pub enum Surface<'py> {
    Uniform(f64),
    Map(Bound<'py, FrictionMap>),
    Path(Bound<'py, Path>),
}

impl Surface<'_> {
    /// The friction for the plant; on a path the search for the first wheel starts at the arc length `hint`.
    ///
    /// # Errors
    /// Errors if the coefficient is not positive.
    pub fn friction(&self, hint: Option<f64>) -> PyResult<Box<dyn Friction + '_>> {
        Ok(match self {
            Self::Uniform(mu) => Box::new(Uniform::new(*mu).map_err(raise)?),
            Self::Map(map) => Box::new(&map.get().0),
            Self::Path(path) => Box::new(OnPath {
                path: &path.get().0,
                last: Cell::new(hint),
            }),
        })
    }
}

/// The friction of a path beside the nearest point on it.
struct OnPath<'a> {
    path: &'a egp_path::Path,
    /// Arc length under the last wheel, where the search for the next one starts.
    last: Cell<Option<f64>>,
}

impl Friction for OnPath<'_> {
    fn coefficient(&self, position: [f64; 2]) -> f64 {
        let projection = self.path.project(position, self.last.get());
        self.last.set(Some(projection.s));
        self.path.friction_beside(projection.s, projection.lateral)
    }
}
