//! The simulated vehicle.

use std::collections::BTreeMap;

use egp_plant::{Disturbances, PlantError, VehicleId, VehicleState};
use pyo3::prelude::*;
use serde::Deserialize as _;
use serde::de::value::{Error, MapDeserializer};

use crate::array::{NewVector, Vector, fixed, vector};
use crate::error::{InvalidArgumentError, VehicleLostError};
use crate::parameters::VehicleParameters;
use crate::path::check_hint;
use crate::surface::Road;

#[doc = doc!(Plant)]
#[pyclass(module = "egp_service._core")]
pub struct Plant(pub egp_plant::Plant, VehicleId);

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (vehicle = 1, disturbances = None))]
    fn new(vehicle: u32, disturbances: Option<BTreeMap<String, f64>>) -> PyResult<Self> {
        let id = VehicleId::try_from(vehicle).map_err(InvalidArgumentError::raise)?;
        let mut plant = egp_plant::Plant::new(id.parameters());
        if let Some(fields) = disturbances {
            let deserializer = MapDeserializer::<_, Error>::new(fields.into_iter());
            let disturbances = Disturbances::deserialize(deserializer)
                .map_err(|error| InvalidArgumentError::new_err(format!("disturbances: {error}")))?;
            plant
                .disturb(&disturbances)
                .map_err(InvalidArgumentError::raise)?;
        }
        Ok(Self(plant, id))
    }

    #[doc = doc!(Plant.reset)]
    #[pyo3(signature = (x, y, yaw, v, *, yaw_rate = 0.0, v_y = 0.0, delta = 0.0))]
    #[allow(clippy::too_many_arguments)]
    fn reset(
        &mut self,
        x: f64,
        y: f64,
        yaw: f64,
        v: f64,
        yaw_rate: f64,
        v_y: f64,
        delta: f64,
    ) -> PyResult<()> {
        let state = VehicleState::from_array([x, y, v, yaw, v_y, yaw_rate, delta]);
        self.0.reset(&state).map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(Plant.step)]
    #[pyo3(signature = (u, dt, friction, hint = None))]
    fn step(
        &mut self,
        u: Vector<'_>,
        dt: f64,
        friction: Road<'_>,
        hint: Option<f64>,
    ) -> PyResult<()> {
        let input = fixed("u", &u)?;
        check_hint(hint)?;
        let friction = friction.friction(hint)?;
        let stepped = self.0.step(input, dt, friction.as_ref());
        stepped.map_err(plant_error)
    }

    #[doc = doc!(Plant.state)]
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, *self.0.state())
    }

    #[setter]
    fn set_state(&mut self, state: Vector<'_>) -> PyResult<()> {
        self.0
            .set_state(&fixed("state", &state)?)
            .map_err(InvalidArgumentError::raise)
    }

    #[doc = doc!(Plant.vehicle_state)]
    #[getter]
    fn vehicle_state<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.vehicle_state().to_array())
    }

    #[doc = doc!(Plant.parameters)]
    #[getter]
    fn parameters(&self) -> VehicleParameters {
        VehicleParameters(self.1.vehicle())
    }

    #[doc = doc!(Plant.mass)]
    #[getter]
    fn mass(&self) -> f64 {
        self.0.parameters().mass
    }

    fn __repr__(&self) -> String {
        let VehicleState {
            p_x, p_y, v_x, psi, ..
        } = self.0.vehicle_state();
        let vehicle = self.1.number();
        format!("Plant(vehicle={vehicle}, x={p_x:.3}, y={p_y:.3}, yaw={psi:.4}, v={v_x:.3})")
    }
}

/// An error of a plant as an exception: of an argument, or of a vehicle that has left the domain of the plant.
pub fn plant_error(error: PlantError) -> PyErr {
    match error {
        PlantError::Spun { .. } | PlantError::Diverged { .. } => {
            VehicleLostError::new_err(error.to_string())
        }
        _ => InvalidArgumentError::raise(error),
    }
}
