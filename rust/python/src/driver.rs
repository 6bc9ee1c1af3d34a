//! The driver's state machine as Python's transports use it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::time::Duration;

use egp_driver::{Action, Discovery, DriverConfig, Measurement, QueryId};
use egp_wire::Ready;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::array::{Matrix, NewMatrix, NewVector, Vector, fixed, rows, vector};
use crate::error::{InvalidArgumentError, raise};
use crate::gate::{configure, mode_name};
use crate::wire::matrix;

/// A question to a replica, to be sent as it is.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct Query {
    id: u64,
    replica: String,
    key: String,
    payload: Cow<'static, [u8]>,
    listen: f64,
}

/// What one control period brought.
#[pyclass(module = "egp_service._core", frozen)]
pub struct Decision(pub egp_driver::Step);

#[pymethods]
impl Decision {
    #[getter]
    fn u<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.command.u)
    }

    #[getter]
    fn mode(&self) -> &'static str {
        mode_name(self.0.command.mode)
    }

    #[getter]
    fn limited(&self) -> bool {
        self.0.command.limited
    }

    #[getter]
    fn status(&self) -> &'static str {
        self.0.outcome.name()
    }

    #[getter]
    fn detail(&self) -> String {
        let lost = self.0.lost.map(|lost| lost.to_string());
        lost.unwrap_or_else(|| self.0.outcome.detail())
    }

    #[getter]
    fn lost(&self) -> bool {
        self.0.lost.is_some()
    }

    #[getter]
    fn envelope_distance(&self) -> f64 {
        self.0.situation.map_or(f64::NAN, |here| here.envelope)
    }

    #[getter]
    fn plan_x<'py>(&self, py: Python<'py>) -> PyResult<Option<NewMatrix<'py>>> {
        self.rows(py, |reply| &reply.plan_x)
    }

    #[getter]
    fn plan_u<'py>(&self, py: Python<'py>) -> PyResult<Option<NewMatrix<'py>>> {
        self.rows(py, |reply| &reply.plan_u)
    }

    #[getter]
    fn sigma<'py>(&self, py: Python<'py>) -> PyResult<Option<NewMatrix<'py>>> {
        self.rows(py, |reply| &reply.sigma)
    }

    #[getter]
    fn replica(&self) -> String {
        self.0
            .replica
            .as_ref()
            .map_or_else(String::new, ToString::to_string)
    }

    #[getter]
    fn request<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0.request)
    }

    #[getter]
    fn reply<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyBytes>> {
        self.0
            .reply
            .as_ref()
            .map(|_| PyBytes::new(py, &self.0.reply_bytes))
    }

    #[getter]
    fn late<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyBytes>> {
        self.0
            .late
            .iter()
            .map(|late| PyBytes::new(py, &late.reply_bytes))
            .collect()
    }

    /// Seconds in the service's queue and in its worker; zeros when the reply does not say.
    #[getter]
    fn service_time(&self) -> (f64, f64) {
        let seconds = |us: u32| 1e-6 * f64::from(us);
        self.0.timing.map_or((0.0, 0.0), |timing| {
            (seconds(timing.queue_us), seconds(timing.step_us))
        })
    }

    #[getter]
    fn asked(&self) -> u32 {
        self.0.asked
    }
}

impl Decision {
    /// A tensor of the reply; none when there is no reply or the tensor has no rows, which is how a field is absent on
    /// the wire.
    fn rows<'py, const W: usize>(
        &self,
        py: Python<'py>,
        field: impl Fn(&egp_wire::Reply) -> &Vec<[f64; W]>,
    ) -> PyResult<Option<NewMatrix<'py>>> {
        let rows = self
            .0
            .reply
            .as_ref()
            .map(field)
            .filter(|rows| !rows.is_empty());
        rows.map(|rows| matrix(py, rows)).transpose()
    }
}

/// The configuration behind both kinds of drivers.
pub fn driver_config(
    fleet: &str,
    vehicle: &str,
    gate: BTreeMap<String, f64>,
    budget: f64,
    want_sigma: bool,
) -> PyResult<DriverConfig> {
    let (limits, max_tail_ticks, stop_deceleration) = configure(gate)?;
    let config = DriverConfig::new(fleet, vehicle, limits);
    Ok(DriverConfig {
        budget,
        max_tail_ticks,
        stop_deceleration,
        want_sigma,
        ..config.map_err(InvalidArgumentError::raise)?
    })
}

/// Measured state, reference and widths from Python.
pub fn measurement(
    x: &Vector<'_>,
    reference: &Matrix<'_>,
    widths: Option<&Matrix<'_>>,
) -> PyResult<Measurement> {
    Ok(Measurement {
        x: fixed("x", x)?,
        reference: rows("reference", reference)?,
        widths: widths.map_or_else(|| Ok(Vec::new()), |widths| rows("widths", widths))?,
    })
}

fn time(seconds: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(seconds).map_err(raise)
}

/// The state machine of one vehicle.
#[pyclass(module = "egp_service._core")]
struct Driver(egp_driver::Driver);

#[pymethods]
impl Driver {
    #[new]
    #[pyo3(signature = (ready, *, fleet, vehicle, gate, budget = 0.8, want_sigma = false))]
    fn new(
        ready: &[u8],
        fleet: &str,
        vehicle: &str,
        gate: BTreeMap<String, f64>,
        budget: f64,
        want_sigma: bool,
    ) -> PyResult<Self> {
        let config = driver_config(fleet, vehicle, gate, budget, want_sigma)?;
        let ready = Ready::decode(ready, &egp_wire::Limits::default()).map_err(raise)?;
        egp_driver::Driver::new(config, ready)
            .map(Self)
            .map_err(InvalidArgumentError::raise)
    }

    fn replica_appeared(&mut self, now: f64, replica: &str) -> PyResult<()> {
        self.0
            .replica_appeared(time(now)?, replica.parse().map_err(raise)?);
        Ok(())
    }

    fn replica_gone(&mut self, now: f64, replica: &str) -> PyResult<()> {
        self.0
            .replica_gone(time(now)?, &replica.parse().map_err(raise)?);
        Ok(())
    }

    #[pyo3(signature = (now, deadline, x, reference, widths = None))]
    fn tick(
        &mut self,
        now: f64,
        deadline: f64,
        x: Vector<'_>,
        reference: Matrix<'_>,
        widths: Option<Matrix<'_>>,
    ) -> PyResult<()> {
        let measurement = measurement(&x, &reference, widths.as_ref())?;
        let ticked = self.0.tick(time(now)?, time(deadline)?, measurement);
        ticked.map_err(InvalidArgumentError::raise)
    }

    fn wake(&mut self, now: f64) -> PyResult<()> {
        self.0.wake(time(now)?);
        Ok(())
    }

    fn replied(&mut self, now: f64, query: u64, payload: &[u8], attachment: &[u8]) -> PyResult<()> {
        self.0
            .replied(time(now)?, QueryId(query), payload, attachment);
        Ok(())
    }

    fn refused(&mut self, now: f64, query: u64, error: &[u8]) -> PyResult<()> {
        self.0.refused(time(now)?, QueryId(query), error);
        Ok(())
    }

    fn ended(&mut self, now: f64, query: u64) -> PyResult<()> {
        self.0.ended(time(now)?, QueryId(query));
        Ok(())
    }

    fn next_action(&mut self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        Ok(match self.0.next_action() {
            None => None,
            Some(Action::Command(step)) => Some(Py::new(py, Decision(*step))?.into_any()),
            Some(Action::Ask(query) | Action::Probe(query)) => {
                let query = Query {
                    id: query.id.0,
                    replica: query.replica.to_string(),
                    key: query.key,
                    payload: query.payload.into(),
                    listen: query.listen.as_secs_f64(),
                };
                Some(Py::new(py, query)?.into_any())
            }
        })
    }

    #[getter]
    fn budget(&self) -> f64 {
        self.0.budget().as_secs_f64()
    }

    #[getter]
    fn mode(&self) -> &'static str {
        mode_name(self.0.mode())
    }

    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.weights().iter().copied())
    }

    fn hold_weights(&mut self, weights: Vector<'_>) {
        self.0
            .hold_weights(weights.as_array().iter().copied().collect());
    }

    fn reset(&mut self) {
        self.0.reset();
    }
}

/// Whom to ask what the service serves, before there is a driver.
#[pyclass(name = "Discovery", module = "egp_service._core")]
struct Discover(Discovery);

#[pymethods]
impl Discover {
    #[new]
    #[pyo3(signature = (*, fleet, vehicle, gate, budget = 0.8))]
    fn new(fleet: &str, vehicle: &str, gate: BTreeMap<String, f64>, budget: f64) -> PyResult<Self> {
        let config = driver_config(fleet, vehicle, gate, budget, false)?;
        Discovery::new(&config)
            .map(Self)
            .map_err(InvalidArgumentError::raise)
    }

    fn replica_appeared(&mut self, replica: &str) -> PyResult<()> {
        self.0.replica_appeared(replica.parse().map_err(raise)?);
        Ok(())
    }

    fn replica_gone(&mut self, replica: &str) -> PyResult<()> {
        self.0.replica_gone(&replica.parse().map_err(raise)?);
        Ok(())
    }

    #[getter]
    fn live(&self) -> Vec<String> {
        self.0.live().map(ToString::to_string).collect()
    }

    fn next_question(&mut self) -> Option<(String, String)> {
        let (replica, key) = self.0.next_question()?;
        Some((replica.to_string(), key))
    }

    fn is_usable(&mut self, replica: &str, answer: &[u8]) -> PyResult<bool> {
        let replica = replica.parse().map_err(raise)?;
        Ok(self.0.answered(&replica, answer).is_some())
    }

    #[getter]
    fn error(&self) -> String {
        self.0.error().to_string()
    }

    #[getter]
    fn unusable(&self) -> BTreeMap<String, String> {
        let reasons = self.0.error().0.into_iter();
        reasons
            .map(|(replica, reason)| (replica.to_string(), reason.to_string()))
            .collect()
    }
}

/// Adds the classes to the module.
///
/// # Errors
/// Errors if the module does not accept the name.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Decision>()?;
    module.add_class::<Discover>()?;
    module.add_class::<Driver>()?;
    module.add_class::<Query>()
}
