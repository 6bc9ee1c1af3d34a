//! What only tests and benchmarks call: parts of plant and wire by themselves.

use std::sync::{Mutex, PoisonError};

use egp_plant::{Parameters, Surface, VehicleId, VehicleState};
use egp_service::map::MapConfig;
use egp_wire::keys;
use prost::Message as _;
use pyo3::prelude::*;

use crate::array::{Matrix, NewMatrix, NewVector, Vector};
use crate::array::{fixed, rows, vector};
use crate::error::{InvalidArgumentError, raise};
use crate::plant::{Plant, plant_error};
use crate::wire::{matrix, name};

/// One coefficient, or one for each wheel.
#[derive(FromPyObject)]
pub enum WheelFriction<'py> {
    Uniform(f64),
    Wheels(Vector<'py>),
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
    .map_err(plant_error)
}

/// Lateral acceleration of a plant's body in m/s².
#[pyfunction]
pub fn plant_lateral_acceleration(plant: &Plant) -> f64 {
    plant.0.lateral_acceleration()
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
            egp_plant::initial_state(&parameters, &VehicleState::from_array(row))
                .map_err(InvalidArgumentError::raise)
        })
        .collect::<PyResult<Vec<_>>>()?;
    matrix(py, &states)
}

fn parameters(vehicle: u32) -> PyResult<Parameters> {
    VehicleId::try_from(vehicle)
        .map(VehicleId::parameters)
        .map_err(InvalidArgumentError::raise)
}

/// Read a Timing: microseconds in the queue and in the step.
#[pyfunction]
pub fn decode_timing(data: &[u8]) -> PyResult<(u32, u32)> {
    let timing = egp_wire::Timing::decode(data).map_err(raise)?;
    Ok((timing.queue_us, timing.step_us))
}

/// A map service that runs in this process until it is stopped; a context manager.
#[pyclass(module = "egp_service._core.testing", frozen)]
pub struct MapServer(Mutex<Option<egp_service::map::MapServer>>);

#[pymethods]
impl MapServer {
    #[new]
    fn new(py: Python<'_>, config_toml: &str) -> PyResult<Self> {
        let config = MapConfig::from_toml(config_toml).map_err(raise)?;
        let server = py
            .detach(|| egp_service::map::MapServer::start(&config))
            .map_err(raise)?;
        Ok(Self(Mutex::new(Some(server))))
    }

    /// Answer the queries that wait, write what is not yet written, and close. Raises `EgpError` if a road is not written.
    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        let server = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        server.map_or(Ok(()), |server| py.detach(|| server.stop()).map_err(raise))
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(
        &self,
        py: Python<'_>,
        _exception: &Bound<'_, pyo3::types::PyTuple>,
    ) -> PyResult<()> {
        self.stop(py)
    }
}

/// The key on which a vehicle asks a replica for a control step.
#[pyfunction]
pub fn step_key(replica: &str, fleet: &str, vehicle: &str) -> PyResult<String> {
    Ok(keys::step(&name(replica)?, &name(fleet)?, &name(vehicle)?))
}

/// The key on which a replica answers what it serves.
#[pyfunction]
pub fn ready_key(replica: &str) -> PyResult<String> {
    name(replica).map(|replica| keys::ready(&replica))
}

/// The liveliness token of a replica.
#[pyfunction]
pub fn live_key(replica: &str) -> PyResult<String> {
    name(replica).map(|replica| keys::live(&replica))
}
