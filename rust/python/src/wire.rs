//! The messages and the keys of the wire.

use std::borrow::Cow;

use egp_wire::{Predictions, keys};
use pyo3::prelude::*;

use crate::array::{KeptCube, KeptMatrix, KeptVector, NewCube, NewMatrix, array, vector};
use crate::error::{InvalidArgumentError, raise};
use crate::parameters::VehicleParameters;
use crate::text::truth;

pub fn matrix<'py, const W: usize>(py: Python<'py>, rows: &[[f64; W]]) -> PyResult<NewMatrix<'py>> {
    array(py, rows.as_flattened().to_vec(), [rows.len(), W])
}

fn cube<'py>(py: Python<'py>, rows: &Predictions, members: usize) -> PyResult<NewCube<'py>> {
    let values = rows.values.as_flattened().to_vec();
    array(py, values, [rows.len(), members, 3])
}

/// A validated request with the fields of the .proto; a field that is absent has no rows.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct Request {
    library: Cow<'static, [u8]>,
    sequence: u64,
    budget_us: u32,
    x: KeptVector,
    u_prev: KeptVector,
    weights: KeptVector,
    plan_x: KeptMatrix,
    plan_u: KeptMatrix,
    plan_shift: u32,
    history_z: KeptMatrix,
    history_y: KeptMatrix,
    history_f: KeptCube,
    reference: KeptMatrix,
    widths: KeptMatrix,
    want_sigma: bool,
    road_friction: KeptMatrix,
}

#[doc = doc!(Friction)]
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct Friction {
    /// Mean.
    mean: f64,
    /// Standard deviation.
    std: f64,
    /// 5 % quantile.
    lower: f64,
    /// 95 % quantile.
    upper: f64,
    /// Information in the transitions, nats.
    information: f64,
    /// Whether the transitions have information about the friction.
    informed: bool,
    /// Logarithm of the likelihood of each friction coefficient of the wire's hypotheses, relative to the largest.
    log_likelihood: KeptVector,
    /// Test of the likeliest friction for bias.
    misfit: f64,
}

#[pymethods]
impl Friction {
    #[new]
    #[allow(clippy::too_many_arguments)] // the fields of a friction
    fn new(
        mean: f64,
        std: f64,
        lower: f64,
        upper: f64,
        information: f64,
        informed: bool,
        log_likelihood: KeptVector,
        misfit: f64,
    ) -> Self {
        Self {
            mean,
            std,
            lower,
            upper,
            information,
            informed,
            log_likelihood,
            misfit,
        }
    }

    /// The arguments of `new`, from which pickle makes the same friction again.
    fn __getnewargs__(&self, py: Python<'_>) -> (f64, f64, f64, f64, f64, bool, KeptVector, f64) {
        let log_likelihood = self.log_likelihood.clone_ref(py);
        (
            self.mean,
            self.std,
            self.lower,
            self.upper,
            self.information,
            self.informed,
            log_likelihood,
            self.misfit,
        )
    }

    fn __repr__(&self) -> String {
        let Self {
            mean,
            std,
            lower,
            upper,
            information,
            misfit,
            ..
        } = self;
        let informed = truth(self.informed);
        format!(
            "Friction(mean={mean:.3}, std={std:.3}, lower={lower:.3}, upper={upper:.3}, \
             information={information:.3}, informed={informed}, \
             misfit={misfit:.3})"
        )
    }
}

impl Friction {
    /// The friction of a reply, if it has one.
    pub fn of(py: Python<'_>, reply: &egp_wire::Reply) -> PyResult<Option<Py<Self>>> {
        let object = |friction: &egp_wire::Friction| {
            let friction = Self {
                mean: friction.mean,
                std: friction.std,
                lower: friction.lower,
                upper: friction.upper,
                information: friction.information,
                informed: friction.informed(),
                log_likelihood: vector(py, friction.log_likelihood).unbind(),
                misfit: friction.misfit,
            };
            Py::new(py, friction)
        };
        reply.friction.as_ref().map(object).transpose()
    }
}

/// A validated reply with the fields of the .proto; a field that is absent has no rows. Only a "solved" one has a plan.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct Reply {
    library: Cow<'static, [u8]>,
    sequence: u64,
    status: String,
    plan_x: KeptMatrix,
    plan_u: KeptMatrix,
    weights: KeptVector,
    sigma: KeptMatrix,
    history_f: KeptCube,
    dropped_mass: f64,
    iterations: u32,
    kkt_residual: f64,
    solver: String,
    friction: Option<Py<Friction>>,
}

/// An error reply of the service.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct Refusal {
    /// The kind of error; "unspecified" for a code that this version does not have.
    code: String,
    /// Whether another attempt, at this or another replica, may succeed.
    retryable: bool,
    /// Time to wait before another attempt, microseconds.
    retry_after_us: u32,
    /// The field at fault, or an empty string.
    field: String,
    /// What was expected, what came, and what to try.
    detail: String,
}

/// What a replica serves.
#[pyclass(name = "Ready", module = "egp_service._core", frozen, get_all)]
pub struct Replica {
    /// False while the replica drains.
    ready: bool,
    /// SHA-256 of its library file.
    library: Cow<'static, [u8]>,
    /// SHA-256 of the further libraries that it serves.
    others: Vec<Cow<'static, [u8]>>,
    /// Control period in s.
    dt: f64,
    /// Inputs in a plan, T.
    horizon: u32,
    /// Largest useful number of transitions in a request, K.
    history: u32,
    /// Surfaces, in the order of the weights.
    members: Vec<String>,
    /// Smallest and largest GP input [v_x, v_y, omega, delta, F_x, delta_dot] of the training data.
    envelope: [[f64; 6]; 2],
    /// The vehicle that plans are made for; None from services that do not state it.
    vehicle: Option<Py<VehicleParameters>>,
}

impl Replica {
    /// What a Ready says.
    pub fn of(py: Python<'_>, ready: egp_wire::Ready) -> PyResult<Self> {
        Ok(Self {
            ready: ready.ready,
            library: ready.library.to_vec().into(),
            others: ready.others.iter().map(|id| id.to_vec().into()).collect(),
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
}

/// Read and validate a StepRequest. Raises `EgpError` naming the field at fault.
#[pyfunction]
pub fn decode_request(py: Python<'_>, data: &[u8]) -> PyResult<Request> {
    let request = egp_wire::Request::decode(data).map_err(raise)?;
    Ok(Request {
        library: request.library.to_vec().into(),
        sequence: request.sequence,
        budget_us: request.budget_us,
        x: vector(py, request.x).unbind(),
        u_prev: vector(py, request.u_prev).unbind(),
        weights: vector(py, request.weights).unbind(),
        plan_x: matrix(py, &request.plan_x)?.unbind(),
        plan_u: matrix(py, &request.plan_u)?.unbind(),
        plan_shift: request.plan_shift,
        history_z: matrix(py, &request.history_z)?.unbind(),
        history_y: matrix(py, &request.history_y)?.unbind(),
        history_f: cube(py, &request.history_f, request.history_f.members)?.unbind(),
        reference: matrix(py, &request.reference)?.unbind(),
        widths: matrix(py, &request.widths)?.unbind(),
        want_sigma: request.want_sigma,
        road_friction: matrix(py, &request.road_friction)?.unbind(),
    })
}

/// Read and validate a StepReply. Raises `EgpError` naming the field at fault.
#[pyfunction]
pub fn decode_reply(py: Python<'_>, data: &[u8]) -> PyResult<Reply> {
    let reply = egp_wire::Reply::decode(data).map_err(raise)?;
    let members = reply.weights.len();
    let friction = Friction::of(py, &reply)?;
    Ok(Reply {
        library: reply.library.to_vec().into(),
        sequence: reply.sequence,
        status: egp_wire::status_name(reply.status).to_owned(),
        plan_x: matrix(py, &reply.plan_x)?.unbind(),
        plan_u: matrix(py, &reply.plan_u)?.unbind(),
        weights: vector(py, reply.weights).unbind(),
        sigma: matrix(py, &reply.sigma)?.unbind(),
        history_f: cube(py, &reply.history_f, members)?.unbind(),
        dropped_mass: reply.dropped_mass,
        iterations: reply.iterations,
        kkt_residual: reply.kkt_residual,
        solver: reply.solver,
        friction,
    })
}

/// Read an Error.
#[pyfunction]
pub fn decode_error(data: &[u8]) -> PyResult<Refusal> {
    let error = egp_wire::WireError::decode(data).map_err(raise)?;
    Ok(Refusal {
        code: error.code_name().to_owned(),
        retryable: error.retryable,
        retry_after_us: error.retry_after_us,
        field: error.field,
        detail: error.detail,
    })
}

/// Read and validate a Ready.
#[pyfunction]
pub fn decode_ready(py: Python<'_>, data: &[u8]) -> PyResult<Replica> {
    let ready = egp_wire::Ready::decode(data).map_err(raise)?;
    Replica::of(py, ready)
}

/// The serialised google.protobuf.FileDescriptorSet of the messages.
#[pyfunction]
pub fn file_descriptor_set() -> Cow<'static, [u8]> {
    egp_wire::FILE_DESCRIPTOR_SET.into()
}

pub fn name(text: &str) -> PyResult<keys::Name> {
    text.parse().map_err(InvalidArgumentError::raise)
}

/// Name of the replica whose liveliness token this is, or None.
#[pyfunction]
pub fn replica_of_live(key: &str) -> Option<String> {
    keys::replica_of_live(key).map(|replica| replica.to_string())
}

/// Name of the replica that publishes its load on this key, or None.
#[pyfunction]
pub fn replica_of_load(key: &str) -> Option<String> {
    keys::replica_of_load(key).map(|replica| replica.to_string())
}

/// The key on which a vehicle publishes its status.
#[pyfunction]
pub fn vehicle_key(fleet: &str, vehicle: &str) -> PyResult<String> {
    Ok(keys::vehicle(&name(fleet)?, &name(vehicle)?))
}

/// The key on which a vehicle answers its road.
#[pyfunction]
pub fn vehicle_road_key(fleet: &str, vehicle: &str) -> PyResult<String> {
    Ok(keys::vehicle_road(&name(fleet)?, &name(vehicle)?))
}

/// Fleet and name of the vehicle that publishes its status on this key, or None.
#[pyfunction]
pub fn publishing_vehicle(key: &str) -> Option<(String, String)> {
    let (fleet, vehicle) = keys::publishing_vehicle(key)?;
    Some((fleet.to_string(), vehicle.to_string()))
}
