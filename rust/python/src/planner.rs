//! The speed planner and the belief about the road's friction.

use egp_map::BeliefSettings;
use egp_parameters::FRICTION_HYPOTHESES;
use egp_path::SpeedLimits;
use pyo3::prelude::*;

use crate::array::{NewVector, Vector, fixed, vector};
use crate::error::raise;
use crate::parameters::VehicleParameters;
use crate::path::{Path, SpeedProfile};

#[doc = doc!(SpeedPlanner)]
#[pyclass(module = "egp_service._core")]
pub struct SpeedPlanner(egp_path::SpeedPlanner);

#[pymethods]
impl SpeedPlanner {
    #[new]
    #[pyo3(signature = (path, vehicle, grip = 0.8, v_max = 30.0))]
    fn new(path: &Path, vehicle: &VehicleParameters, grip: f64, v_max: f64) -> PyResult<Self> {
        let limits = SpeedLimits {
            grip,
            v_max,
            ..SpeedLimits::of(&vehicle.0)
        };
        egp_path::SpeedPlanner::new(&path.0, &limits)
            .map(Self)
            .map_err(raise)
    }

    #[doc = doc!(SpeedPlanner.places)]
    fn places<'py>(&self, py: Python<'py>, s: f64) -> NewVector<'py> {
        let (start, step) = (self.0.start(s), self.0.step());
        vector(py, (0..self.0.places()).map(|i| start + i as f64 * step))
    }

    #[doc = doc!(SpeedPlanner.plan)]
    #[pyo3(signature = (s, friction, v = None))]
    fn plan(&mut self, s: f64, friction: Vector<'_>, v: Option<f64>) -> PyResult<SpeedProfile> {
        let friction: Vec<f64> = friction.as_array().iter().copied().collect();
        let profile = self.0.plan(s, v, &friction).map_err(raise)?;
        Ok(SpeedProfile::of(profile.clone()))
    }

    #[doc = doc!(SpeedPlanner.plan_by_belief)]
    #[pyo3(signature = (s, belief, risk, v = None))]
    fn plan_by_belief(
        &mut self,
        s: f64,
        belief: &mut RoadBelief,
        risk: f64,
        v: Option<f64>,
    ) -> PyResult<SpeedProfile> {
        let mut friction = vec![0.0; self.0.places()];
        (belief
            .0
            .ahead(self.0.start(s), self.0.step(), risk, &mut friction))
        .map_err(raise)?;
        let profile = self.0.plan(s, v, &friction).map_err(raise)?;
        Ok(SpeedProfile::of(profile.clone()))
    }
}

#[doc = doc!(RoadBelief)]
#[pyclass(module = "egp_service._core")]
pub struct RoadBelief(egp_map::RoadBelief);

#[pymethods]
impl RoadBelief {
    #[new]
    #[pyo3(signature = (path, *, change_distance = 200.0, commitment = 40.0, capacity = 6.0))]
    fn new(path: &Path, change_distance: f64, commitment: f64, capacity: f64) -> PyResult<Self> {
        let settings = BeliefSettings {
            change_distance,
            commitment,
            capacity,
        };
        let path = &path.0;
        egp_map::RoadBelief::new(path.length(), path.closed(), &settings)
            .map(Self)
            .map_err(raise)
    }

    #[doc = doc!(RoadBelief.observe)]
    fn observe(
        &mut self,
        start: f64,
        end: f64,
        log_likelihood: Vector<'_>,
        weight: f64,
    ) -> PyResult<()> {
        let evidence = fixed::<FRICTION_HYPOTHESES>("log_likelihood", &log_likelihood)?;
        self.0.observe(start, end, &evidence, weight).map_err(raise)
    }

    #[doc = doc!(RoadBelief.quantiles)]
    fn quantiles(&mut self, s: f64, shares: [f64; 3]) -> PyResult<[f64; 3]> {
        self.0.quantiles(s, shares).map_err(raise)
    }
}
