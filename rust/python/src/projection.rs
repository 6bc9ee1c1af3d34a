//! `Projection`.

use pyo3::prelude::*;

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
