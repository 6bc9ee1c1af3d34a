//! `Plant` and the functions on many states at once.

use std::collections::BTreeMap;

use egp_plant::{
    BatchItem, Disturbances, NX, Parameters, StateVector, Surface, Uniform, VehicleId, VehicleState,
};
use pyo3::prelude::*;
use serde::Deserialize as _;
use serde::de::value::{Error, MapDeserializer};

use crate::array::{Matrix, NewMatrix, NewVector, Vector, array, fixed, rows, vector};
use crate::error::{EgpError, raise};
use crate::parameters::VehicleParameters;
use crate::surface::{Road, SurfaceValue};

/// A batch after one period: the states, and which plants completed it.
type Stepped<'py> = (NewMatrix<'py>, NewVector<'py, bool>);

#[doc = doc!(Plant)]
#[pyclass(module = "egp_service._core")]
pub struct Plant(egp_plant::Plant, VehicleId);

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (vehicle = 1, disturbances = None))]
    fn new(vehicle: u32, disturbances: Option<BTreeMap<String, f64>>) -> PyResult<Self> {
        let id = VehicleId::try_from(vehicle).map_err(raise)?;
        let mut plant = egp_plant::Plant::new(id.parameters());
        if let Some(fields) = disturbances {
            let deserializer = MapDeserializer::<_, Error>::new(fields.into_iter());
            let disturbances = Disturbances::deserialize(deserializer)
                .map_err(|error| raise(format!("disturbances: {error}")))?;
            plant.disturb(&disturbances).map_err(raise)?;
        }
        Ok(Self(plant, id))
    }

    #[doc = doc!(Plant.reset)]
    #[pyo3(signature = (x, y, yaw, v, yaw_rate = 0.0, v_y = 0.0, delta = 0.0))]
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
        self.0.reset(&state).map_err(raise)
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
        if let Some(hint) = hint.filter(|hint| !hint.is_finite()) {
            return Err(EgpError::new_err(format!(
                "expected a finite hint, got {hint}"
            )));
        }
        let friction = friction.friction(hint)?;
        self.0.step(input, dt, friction.as_ref()).map_err(raise)
    }

    #[doc = doc!(Plant.state)]
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, *self.0.state())
    }

    #[setter]
    fn set_state(&mut self, state: Vector<'_>) -> PyResult<()> {
        self.0.set_state(&fixed("state", &state)?).map_err(raise)
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

    #[doc = doc!(Plant.lateral_acceleration)]
    #[getter]
    fn lateral_acceleration(&self) -> f64 {
        self.0.lateral_acceleration()
    }
}

/// One coefficient, or one for each wheel.
#[derive(FromPyObject)]
pub enum WheelFriction<'py> {
    Uniform(f64),
    Wheels(Vector<'py>),
}

/// A friction coefficient for each vehicle of a batch, or one surface for all.
#[derive(FromPyObject)]
pub enum BatchSurface<'py> {
    Each(Vector<'py>),
    One(SurfaceValue),
}

impl BatchSurface<'_> {
    fn surfaces(&self, count: usize) -> PyResult<Vec<Surface>> {
        match self {
            Self::Each(frictions) => Ok(frictions.as_array().iter().map(|&mu| mu.into()).collect()),
            Self::One(value) => Ok(vec![value.surface()?; count]),
        }
    }
}

/// Right-hand side of the 29 differential equations.
///
/// `friction` is one coefficient or four: front -y, front +y, rear -y, rear +y, with y to the left.
#[pyfunction]
#[pyo3(signature = (state, u, friction, vehicle = 1))]
pub fn plant_derivative<'py>(
    py: Python<'py>,
    state: Vector<'py>,
    u: Vector<'py>,
    friction: WheelFriction<'py>,
    vehicle: u32,
) -> PyResult<NewVector<'py>> {
    let friction: [f64; 4] = match friction {
        WheelFriction::Uniform(mu) => [mu; 4],
        WheelFriction::Wheels(mu) => fixed("friction", &mu)?,
    };
    egp_plant::derivative(
        &parameters(vehicle)?,
        &fixed("state", &state)?,
        fixed("u", &u)?,
        &friction.map(Surface::from),
    )
    .map(|slope| vector(py, slope))
    .map_err(raise)
}

/// Full states (n, 29) for `[p_x, p_y, v_x, psi, v_y, omega, delta]` rows (n, 7).
#[pyfunction]
#[pyo3(signature = (vehicle_states, vehicle = 1))]
pub fn plant_initial_states<'py>(
    py: Python<'py>,
    vehicle_states: Matrix<'py>,
    vehicle: u32,
) -> PyResult<NewMatrix<'py>> {
    let parameters = parameters(vehicle)?;
    let states = rows::<7>("vehicle_states", &vehicle_states)?
        .into_iter()
        .map(|row| {
            egp_plant::initial_state(&parameters, &VehicleState::from_array(row)).map_err(raise)
        })
        .collect::<PyResult<Vec<_>>>()?;
    matrix(py, states)
}

/// Drive n vehicles `dt` seconds on all cores without the GIL.
///
/// States (n, 29), inputs (n, 2), friction (n,) or one surface for all. Returns the new states and which vehicles
/// completed the period; one that spun keeps its state.
#[pyfunction]
#[pyo3(signature = (states, u, dt, friction, vehicle = 1))]
pub fn plant_step_batch<'py>(
    py: Python<'py>,
    states: Matrix<'py>,
    u: Matrix<'py>,
    dt: f64,
    friction: BatchSurface<'py>,
    vehicle: u32,
) -> PyResult<Stepped<'py>> {
    let parameters = parameters(vehicle)?;
    let states = rows::<NX>("states", &states)?;
    let inputs = rows::<2>("u", &u)?;
    let surfaces = friction.surfaces(states.len())?;
    for (name, count) in [("u", inputs.len()), ("friction", surfaces.len())] {
        if count != states.len() {
            let expected = states.len();
            return Err(EgpError::new_err(format!(
                "expected {expected} rows of {name}, one per state, got {count}"
            )));
        }
    }
    let mut items = (states.iter().zip(inputs).zip(surfaces))
        .map(|((state, input), surface)| {
            let mut plant = egp_plant::Plant::new(parameters.clone());
            plant.set_state(state)?;
            Ok(BatchItem {
                plant,
                input,
                friction: Uniform::new(surface)?,
            })
        })
        .collect::<Result<Vec<_>, egp_plant::PlantError>>()
        .map_err(raise)?;
    let results = py
        .detach(|| egp_plant::step_batch(&mut items, dt))
        .map_err(raise)?;
    let completed: Vec<bool> = results.iter().map(Result::is_ok).collect();
    Ok((
        matrix(py, items.iter().map(|item| *item.plant.state()).collect())?,
        vector(py, completed),
    ))
}

fn parameters(vehicle: u32) -> PyResult<Parameters> {
    VehicleId::try_from(vehicle)
        .map(VehicleId::parameters)
        .map_err(raise)
}

fn matrix(py: Python<'_>, states: Vec<StateVector>) -> PyResult<NewMatrix<'_>> {
    let count = states.len();
    array(py, states.into_flattened(), [count, NX])
}
