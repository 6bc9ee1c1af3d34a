//! The wire as Python sees it: the messages and the keys.

use std::borrow::Cow;

use egp_wire::{Limits, Predictions, State, keys};
use prost::Message as _;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::array::{NewCube, NewMatrix, NewVector, Vector, array, fixed, vector};
use crate::error::raise;
use crate::parameters::VehicleParameters;

pub fn matrix<'py, const W: usize>(py: Python<'py>, rows: &[[f64; W]]) -> PyResult<NewMatrix<'py>> {
    array(py, rows.as_flattened().to_vec(), [rows.len(), W])
}

fn cube<'py>(py: Python<'py>, rows: &Predictions, members: usize) -> PyResult<NewCube<'py>> {
    let values = rows.values.as_flattened().to_vec();
    array(py, values, [rows.len(), members, 3])
}

/// A validated request.
#[pyclass(module = "egp_service._core", frozen)]
struct Request(egp_wire::Request);

#[pymethods]
impl Request {
    #[getter]
    fn library<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0.library)
    }

    #[getter]
    fn sequence(&self) -> u64 {
        self.0.sequence
    }

    #[getter]
    fn budget_us(&self) -> u32 {
        self.0.budget_us
    }

    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.x)
    }

    #[getter]
    fn u_prev<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.u_prev)
    }

    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.weights.iter().copied())
    }

    #[getter]
    fn plan_x<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.plan_x)
    }

    #[getter]
    fn plan_u<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.plan_u)
    }

    #[getter]
    fn plan_shift(&self) -> u32 {
        self.0.plan_shift
    }

    #[getter]
    fn history_z<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.history_z)
    }

    #[getter]
    fn history_y<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.history_y)
    }

    #[getter]
    fn history_f<'py>(&self, py: Python<'py>) -> PyResult<NewCube<'py>> {
        cube(py, &self.0.history_f, self.0.history_f.members)
    }

    #[getter]
    fn reference<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.reference)
    }

    #[getter]
    fn widths<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.widths)
    }

    #[getter]
    fn want_sigma(&self) -> bool {
        self.0.want_sigma
    }
}

/// A validated reply.
#[pyclass(module = "egp_service._core", frozen)]
struct Reply(egp_wire::Reply);

#[pymethods]
impl Reply {
    #[getter]
    fn library<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0.library)
    }

    #[getter]
    fn sequence(&self) -> u64 {
        self.0.sequence
    }

    #[getter]
    fn status(&self) -> String {
        let name = self.0.status.as_str_name();
        name.trim_start_matches("STATUS_").to_ascii_lowercase()
    }

    #[getter]
    fn plan_x<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.plan_x)
    }

    #[getter]
    fn plan_u<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.plan_u)
    }

    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.weights.iter().copied())
    }

    #[getter]
    fn sigma<'py>(&self, py: Python<'py>) -> PyResult<NewMatrix<'py>> {
        matrix(py, &self.0.sigma)
    }

    #[getter]
    fn history_f<'py>(&self, py: Python<'py>) -> PyResult<NewCube<'py>> {
        cube(py, &self.0.history_f, self.0.weights.len())
    }

    #[getter]
    fn dropped_mass(&self) -> f64 {
        self.0.dropped_mass
    }

    #[getter]
    fn iterations(&self) -> u32 {
        self.0.iterations
    }

    #[getter]
    fn kkt_residual(&self) -> f64 {
        self.0.kkt_residual
    }

    #[getter]
    fn solver(&self) -> &str {
        &self.0.solver
    }
}

/// A refusal of the service.
#[pyclass(module = "egp_service._core", frozen, get_all)]
struct Refusal {
    code: String,
    retryable: bool,
    retry_after_us: u32,
    field: String,
    detail: String,
}

/// What a replica serves.
#[pyclass(name = "Ready", module = "egp_service._core", frozen, get_all)]
struct Replica {
    ready: bool,
    library: Cow<'static, [u8]>,
    dt: f64,
    horizon: u32,
    history: u32,
    members: Vec<String>,
    envelope: [[f64; 6]; 2],
    vehicle: Option<Py<VehicleParameters>>,
}

#[pyfunction]
fn decode_request(data: &[u8]) -> PyResult<Request> {
    egp_wire::Request::decode(data, &Limits::default())
        .map(Request)
        .map_err(raise)
}

#[pyfunction]
fn decode_reply(data: &[u8]) -> PyResult<Reply> {
    egp_wire::Reply::decode(data, &Limits::default())
        .map(Reply)
        .map_err(raise)
}

#[pyfunction]
fn decode_error(data: &[u8]) -> PyResult<Refusal> {
    let error = egp_wire::WireError::decode(data).map_err(raise)?;
    Ok(Refusal {
        code: error.code_name(),
        retryable: error.retryable,
        retry_after_us: error.retry_after_us,
        field: error.field,
        detail: error.detail,
    })
}

#[pyfunction]
fn decode_ready(py: Python<'_>, data: &[u8]) -> PyResult<Replica> {
    let ready = egp_wire::Ready::decode(data, &Limits::default()).map_err(raise)?;
    Ok(Replica {
        ready: ready.ready,
        library: ready.library.to_vec().into(),
        dt: ready.dt,
        horizon: ready.horizon,
        history: ready.history,
        members: ready.members,
        envelope: ready.envelope,
        vehicle: (ready
            .vehicle
            .map(|vehicle| Py::new(py, VehicleParameters(vehicle))))
        .transpose()?,
    })
}

#[pyfunction]
fn decode_timing(data: &[u8]) -> PyResult<(u32, u32)> {
    let timing = egp_wire::Timing::decode(data).map_err(raise)?;
    Ok((timing.queue_us, timing.step_us))
}

#[pyfunction]
#[pyo3(signature = (
    *, time, state, u, friction, path_s, lateral_error, heading_error, speed_reference, mode, weights
))]
#[allow(clippy::too_many_arguments)]
fn encode_plant_truth(
    time: f64,
    state: Vector<'_>,
    u: [f64; 2],
    friction: f64,
    path_s: f64,
    lateral_error: f64,
    heading_error: f64,
    speed_reference: f64,
    mode: String,
    weights: Vec<f64>,
) -> PyResult<Cow<'static, [u8]>> {
    let [p_x, p_y, v_x, psi, v_y, omega, delta]: State = fixed("state", &state)?;
    let [force, steering_rate] = u;
    let truth = egp_wire::PlantTruth {
        time,
        p_x,
        p_y,
        v_x,
        psi,
        v_y,
        omega,
        delta,
        force,
        steering_rate,
        friction,
        path_s,
        lateral_error,
        heading_error,
        speed_reference,
        mode,
        weights,
    };
    Ok(truth.encode_to_vec().into())
}

#[pyfunction]
fn file_descriptor_set() -> Cow<'static, [u8]> {
    egp_wire::FILE_DESCRIPTOR_SET.into()
}

fn name(text: &str) -> PyResult<keys::Name> {
    text.parse().map_err(raise)
}

#[pyfunction]
fn step_key(replica: &str, fleet: &str, vehicle: &str) -> PyResult<String> {
    Ok(keys::step(&name(replica)?, &name(fleet)?, &name(vehicle)?))
}

#[pyfunction]
fn ready_key(replica: &str) -> PyResult<String> {
    name(replica).map(|replica| keys::ready(&replica))
}

#[pyfunction]
fn health_key(replica: &str) -> PyResult<String> {
    name(replica).map(|replica| keys::health(&replica))
}

#[pyfunction]
fn metrics_key(replica: &str) -> PyResult<String> {
    name(replica).map(|replica| keys::metrics(&replica))
}

#[pyfunction]
fn live_key(replica: &str) -> PyResult<String> {
    name(replica).map(|replica| keys::live(&replica))
}

#[pyfunction]
fn replica_of_live(key: &str) -> Option<String> {
    keys::replica_of_live(key).map(|replica| replica.to_string())
}

/// Adds the classes and functions to the module.
///
/// # Errors
/// Errors if the module does not accept the name.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("LIVE_KEYS", keys::ALL_LIVE)?;
    module.add_class::<Replica>()?;
    module.add_class::<Refusal>()?;
    module.add_class::<Reply>()?;
    module.add_class::<Request>()?;
    module.add_function(wrap_pyfunction!(decode_error, module)?)?;
    module.add_function(wrap_pyfunction!(decode_ready, module)?)?;
    module.add_function(wrap_pyfunction!(decode_reply, module)?)?;
    module.add_function(wrap_pyfunction!(decode_request, module)?)?;
    module.add_function(wrap_pyfunction!(decode_timing, module)?)?;
    module.add_function(wrap_pyfunction!(encode_plant_truth, module)?)?;
    module.add_function(wrap_pyfunction!(file_descriptor_set, module)?)?;
    module.add_function(wrap_pyfunction!(health_key, module)?)?;
    module.add_function(wrap_pyfunction!(live_key, module)?)?;
    module.add_function(wrap_pyfunction!(metrics_key, module)?)?;
    module.add_function(wrap_pyfunction!(ready_key, module)?)?;
    module.add_function(wrap_pyfunction!(replica_of_live, module)?)?;
    module.add_function(wrap_pyfunction!(step_key, module)?)
}
