//! The speed planner and the belief about the road's friction.

use std::borrow::Cow;

use egp_map::{MergeSettings, Tile, merge};
use egp_parameters::FRICTION_HYPOTHESES;
use egp_path::SpeedLimits;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::array::{Matrix, NewMatrix, NewVector, Vector, fixed, vector};
use crate::error::{InvalidArgumentError, raise};
use crate::parameters::VehicleParameters;
use crate::path::Path;
use crate::speed::{SpeedProfile, tyre_rows};
use crate::text::truth;
use crate::wire::matrix;

#[doc = doc!(SpeedPlanner)]
#[pyclass(module = "egp_service._core")]
pub struct SpeedPlanner(egp_path::SpeedPlanner);

#[pymethods]
impl SpeedPlanner {
    #[new]
    #[pyo3(signature = (path, vehicle, grip = 0.8, v_max = 30.0, *, end_speed = None, tyres = None))]
    fn new(
        path: &Path,
        vehicle: &VehicleParameters,
        grip: f64,
        v_max: f64,
        end_speed: Option<f64>,
        tyres: Option<Matrix<'_>>,
    ) -> PyResult<Self> {
        let limits = SpeedLimits {
            grip,
            v_max,
            end_speed,
            tyres: tyre_rows(tyres)?,
            ..SpeedLimits::of(&vehicle.0)
        };
        egp_path::SpeedPlanner::new(&path.0, &limits)
            .map(Self)
            .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(SpeedPlanner.places)]
    fn places<'py>(&self, py: Python<'py>, s: f64) -> PyResult<NewVector<'py>> {
        if !s.is_finite() {
            let reason = format!("expected a finite arc length s in m, got {s}");
            return Err(InvalidArgumentError::new_err(reason));
        }
        let (start, step) = (self.0.start(s), self.0.step());
        let places = (0..self.0.places()).map(|i| start + i as f64 * step);
        Ok(vector(py, places))
    }

    #[doc = doc!(SpeedPlanner.plan)]
    #[pyo3(signature = (s, friction, v = None))]
    fn plan(&mut self, s: f64, friction: Vector<'_>, v: Option<f64>) -> PyResult<SpeedProfile> {
        let friction: Vec<f64> = friction.as_array().iter().copied().collect();
        let profile = self
            .0
            .plan(s, v, &friction)
            .map_err(InvalidArgumentError::raise)?;
        Ok(SpeedProfile(profile.clone()))
    }

    fn __repr__(&self) -> String {
        let (closed, places, step) = (truth(self.0.closed()), self.0.places(), self.0.step());
        let SpeedLimits { grip, v_max, .. } = self.0.limits();
        format!(
            "SpeedPlanner(closed={closed}, places={places}, step={step:.3}, grip={grip:?}, v_max={v_max:?})"
        )
    }
}

/// Number of points by which a stored belief states its road.
const SHAPE_POINTS: usize = 32;

#[doc = doc!(RoadBelief)]
#[pyclass(module = "egp_service._core")]
pub struct RoadBelief(pub egp_map::RoadBelief);

#[pymethods]
impl RoadBelief {
    #[new]
    #[pyo3(signature = (path, *, window = 25, scale = 1.0))]
    fn new(path: &Path, window: usize, scale: f64) -> PyResult<Self> {
        let path = &path.0;
        let place = |i| path.sample(path.length() * i as f64 / SHAPE_POINTS as f64);
        let points = (0..SHAPE_POINTS).map(place).map(|at| [at.x, at.y]);
        egp_map::RoadBelief::new(path.length(), path.closed())
            .and_then(|belief| belief.with_scale(scale))
            .and_then(|mut belief| belief.set_window(window).map(|()| belief))
            .map(|belief| Self(belief.with_shape(points.collect())))
            .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(RoadBelief.scale)]
    #[getter]
    fn scale(&self) -> f64 {
        self.0.scale()
    }

    #[doc = doc!(RoadBelief.window)]
    #[getter]
    fn window(&self) -> usize {
        self.0.window()
    }

    #[setter]
    fn set_window(&mut self, window: usize) -> PyResult<()> {
        self.0
            .set_window(window)
            .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(RoadBelief.recall)]
    #[pyo3(signature = (data, age = 0.0))]
    fn recall(&mut self, data: &[u8], age: f64) -> PyResult<()> {
        check_age(age)?;
        self.0.recall(data, age).map_err(raise)
    }

    #[doc = doc!(RoadBelief.to_bytes)]
    fn to_bytes(&self) -> PyResult<Cow<'static, [u8]>> {
        Ok(self.0.to_bytes().map_err(raise)?.into())
    }

    #[doc = doc!(RoadBelief.update)]
    #[pyo3(signature = (s, log_likelihood = None))]
    fn update(&mut self, s: f64, log_likelihood: Option<Vector<'_>>) -> PyResult<()> {
        let evidence = log_likelihood
            .map(|values| fixed::<FRICTION_HYPOTHESES>("log_likelihood", &values))
            .transpose()?;
        self.0
            .update(s, evidence.as_ref())
            .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(RoadBelief.preview)]
    fn preview<'py>(&mut self, py: Python<'py>, places: Vector<'py>) -> PyResult<NewMatrix<'py>> {
        let places: Vec<f64> = places.as_array().iter().copied().collect();
        let mut rows = vec![[0.0; 2]; places.len() + 1];
        self.0
            .preview(&places, &mut rows)
            .map_err(InvalidArgumentError::raise)?;
        matrix(py, &rows)
    }

    #[doc = doc!(RoadBelief.leave)]
    fn leave(&mut self) {
        self.0.leave();
    }

    #[doc = doc!(RoadBelief.ahead)]
    fn ahead<'py>(
        &mut self,
        py: Python<'py>,
        places: Vector<'py>,
        risk: f64,
    ) -> PyResult<NewVector<'py>> {
        let places: Vec<f64> = places.as_array().iter().copied().collect();
        check_spacing(&places)?;
        let (start, step) = match (places.first(), places.get(1)) {
            (Some(first), Some(second)) => (*first, second - first),
            (Some(first), None) => (*first, 1.0),
            _ => return Ok(vector(py, [])),
        };
        if step <= 0.0 {
            return Err(InvalidArgumentError::new_err(format!(
                "expected places that increase, got steps of {step} m"
            )));
        }
        let mut friction = vec![0.0; places.len()];
        self.0
            .ahead(start, step, risk, &mut friction)
            .map_err(InvalidArgumentError::raise)?;
        Ok(vector(py, friction))
    }

    #[doc = doc!(RoadBelief.quantiles)]
    fn quantiles<'py>(
        &mut self,
        py: Python<'py>,
        s: Vector<'py>,
        share: f64,
    ) -> PyResult<NewVector<'py>> {
        let s = s.as_array();
        let found: PyResult<Vec<f64>> = (s.iter())
            .map(|s| {
                self.0
                    .quantile(*s, share)
                    .map_err(InvalidArgumentError::raise)
            })
            .collect();
        Ok(vector(py, found?))
    }

    #[doc = doc!(RoadBelief.tile)]
    fn tile(&self, index: usize) -> PyResult<Cow<'static, [u8]>> {
        let tile = self.0.tile(index).map_err(InvalidArgumentError::raise)?;
        Ok(tile.bytes().to_vec().into())
    }

    #[doc = doc!(RoadBelief.report)]
    fn report(&mut self, index: usize, tile: &[u8]) -> PyResult<()> {
        let tile = Tile::from_bytes(tile).map_err(raise)?;
        self.0
            .report(index, &tile)
            .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(RoadBelief.tiles)]
    #[getter]
    fn tiles(&self) -> usize {
        self.0.tiles()
    }

    #[doc = doc!(RoadBelief.trust)]
    #[getter]
    fn trust(&self) -> Option<f64> {
        self.0.trust()
    }

    fn __repr__(&self) -> String {
        let (length, closed) = (self.0.length(), truth(self.0.closed()));
        let (window, tiles) = (self.0.window(), self.0.tiles());
        let trust = self.0.trust().map(|trust| format!(", trust={trust:.3}"));
        let trust = trust.unwrap_or_default();
        format!(
            "RoadBelief(length={length:.3}, closed={closed}, window={window}, tiles={tiles}{trust})"
        )
    }
}

/// Errors unless `age` is a time in s that has passed.
fn check_age(age: f64) -> PyResult<()> {
    if age >= 0.0 && age.is_finite() {
        return Ok(());
    }
    Err(InvalidArgumentError::new_err(format!(
        "expected a number of seconds from 0 on for age, got {age}"
    )))
}

/// Errors unless places have equal distances.
fn check_spacing(places: &[f64]) -> PyResult<()> {
    let [first, second, ..] = *places else {
        return Ok(());
    };
    let step = second - first;
    for pair in places.windows(2) {
        let found = pair[1] - pair[0];
        // The rounding of arc lengths far from 0 is no unequal distance.
        let tolerance = 1e-6 * step.abs() + 4.0 * f64::EPSILON * pair[1].abs();
        if found.is_nan() || (found - step).abs() > tolerance {
            return Err(InvalidArgumentError::new_err(format!(
                "expected places with equal distances, got {step} m between the first two and {found} m from {} to {}",
                pair[0], pair[1]
            )));
        }
    }
    Ok(())
}

#[doc = doc!(merge_tiles)]
#[pyfunction]
#[pyo3(signature = (contributions, *, capacity = None, lifetime = None))]
pub fn merge_tiles(
    contributions: Vec<(Bound<'_, PyBytes>, f64)>,
    capacity: Option<f64>,
    lifetime: Option<f64>,
) -> PyResult<Cow<'static, [u8]>> {
    let default = MergeSettings::default();
    let settings = MergeSettings {
        capacity: capacity.unwrap_or(default.capacity),
        lifetime: lifetime.unwrap_or(default.lifetime),
    };
    settings.validate().map_err(InvalidArgumentError::raise)?;
    let read = |(bytes, age): &(Bound<'_, PyBytes>, f64)| {
        check_age(*age)?;
        Ok((Tile::from_bytes(bytes.as_bytes()).map_err(raise)?, *age))
    };
    let contributions: PyResult<Vec<(Tile, f64)>> = contributions.iter().map(read).collect();
    let contributions = contributions?;
    let merged = merge(
        contributions.iter().map(|(tile, age)| (tile, *age)),
        &settings,
    );
    Ok(merged.bytes().to_vec().into())
}
