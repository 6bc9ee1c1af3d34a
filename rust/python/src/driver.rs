//! The driver's state machine for Python's transports.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::PathBuf;

use egp_driver::{Action, QueryId};
use egp_wire::Ready;
use pyo3::prelude::*;

use crate::array::{KeptMatrix, KeptVector, NewVector, vector};
use crate::driver_arguments::{driver_config, measurement, time, within};
use crate::error::{InvalidArgumentError, raise};
use crate::traces::Tracing;
use crate::wire::{Friction, matrix, name};

/// A question to a replica, to be sent as it is. The driver is told the answer with the query's `id`.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct Query {
    /// Identifies the query to the driver.
    id: u64,
    /// Name of the replica to ask.
    replica: String,
    /// Key of the zenoh query.
    key: String,
    /// Bytes to send.
    payload: Cow<'static, [u8]>,
    /// Bytes to attach; empty if there are none.
    attachment: Cow<'static, [u8]>,
    /// Time to listen for the answer, s.
    listen: f64,
}

/// The result of one control period; `egp_service.Step` has the same fields and more.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct Decision {
    /// Force [N] and steering rate [rad/s] for the actuators (2,).
    u: KeptVector,
    /// The mode of the gate that gave the command: "normal", "tail", "stop" or "waiting".
    mode: &'static str,
    /// Whether a limit changed the command of the plan.
    limited: bool,
    /// The outcome in one word.
    status: &'static str,
    /// Why there is no plan, or why the vehicle counts as lost; empty otherwise.
    detail: String,
    /// Whether the vehicle counts as lost and is therefore stopped.
    lost: bool,
    /// Distance of the state from the library's training data, in half widths; 0 inside.
    envelope_distance: f64,
    /// States of the new plan (T+1, 7).
    plan_x: Option<KeptMatrix>,
    /// Inputs of the new plan (T, 2).
    plan_u: Option<KeptMatrix>,
    /// Standard deviations along the plan (T+1, 3).
    sigma: Option<KeptMatrix>,
    /// Friction that the last transitions indicate; None without a reply.
    friction: Option<Py<Friction>>,
    /// Name of the replica that replied, or that was asked last.
    replica: String,
    /// Bytes of the request; empty if none was made.
    request: Cow<'static, [u8]>,
    /// Bytes of this period's reply.
    reply: Option<Cow<'static, [u8]>>,
    /// Replies to earlier requests that came since the last step.
    late: Vec<Cow<'static, [u8]>>,
    /// Seconds in the service's queue and in its worker; zeros if the reply does not state them.
    service_time: (f64, f64),
    /// Control periods in which the caller was held up; 0 unless they are more than a plan may bridge.
    held_up: u64,
}

impl Decision {
    /// A driver's step as an object of Python.
    pub fn new(py: Python<'_>, step: egp_driver::Step) -> PyResult<Self> {
        let seconds = |us: u32| 1e-6 * f64::from(us);
        let lost = step.lost.map(|lost| lost.to_string());
        let reply = step.reply.as_ref();
        Ok(Self {
            u: vector(py, step.command.u).unbind(),
            mode: step.command.mode.name(),
            limited: step.command.limited,
            status: step.outcome.name(),
            lost: lost.is_some(),
            detail: lost.unwrap_or_else(|| step.outcome.detail()),
            envelope_distance: step
                .situation
                .map_or(f64::NAN, |here| here.envelope_distance),
            plan_x: rows_of(py, reply.map(|reply| &reply.plan_x))?,
            plan_u: rows_of(py, reply.map(|reply| &reply.plan_u))?,
            sigma: rows_of(py, reply.map(|reply| &reply.sigma))?,
            friction: match reply {
                Some(reply) => Friction::of(py, reply)?,
                None => None,
            },
            replica: step
                .replica
                .map_or_else(String::new, |name| name.to_string()),
            request: step.request.into(),
            reply: reply.is_some().then(|| step.reply_bytes.into()),
            late: (step.late.into_iter())
                .map(|late| late.reply_bytes.into())
                .collect(),
            service_time: step.timing.map_or((0.0, 0.0), |timing| {
                (seconds(timing.queue_us), seconds(timing.step_us))
            }),
            held_up: step.held_up,
        })
    }
}

/// A tensor of a reply, or `None` if there is no reply or the tensor has no rows, because an absent field has none.
fn rows_of<const W: usize>(
    py: Python<'_>,
    rows: Option<&Vec<[f64; W]>>,
) -> PyResult<Option<KeptMatrix>> {
    let rows = rows.filter(|rows| !rows.is_empty());
    rows.map(|rows| Ok(matrix(py, rows)?.unbind())).transpose()
}

/// Decides for one vehicle which replica to ask, how long to wait, and which replies to use.
///
/// A state machine without clock, network or threads: it is told each event with the time in s of a clock that does not
/// run backwards, and its actions are to be carried out. `ready` is a replica's answer on its `ready` key, `gate` the
/// settings of the gate, `budget` the part of the control period that an answer may take, `hedge` the part of the time
/// until the deadline after which a second replica is asked, `keys` the text of a file of secret keys with that of this
/// vehicle. `traces` is a file for the spans of control steps, `traces_share` the share of the traces that is written; the
/// driver's clock must then be `time.monotonic`. Raises `InvalidArgumentError` for values out of range, if there is no key,
/// and if the file cannot be written.
#[pyclass(module = "egp_service._core")]
pub struct Driver(egp_driver::Driver, Option<Tracing>);

#[pymethods]
impl Driver {
    #[new]
    #[pyo3(signature = (ready, *, fleet, vehicle, gate, budget = 0.8, hedge = 0.5, want_sigma = false, keys = None, traces = None, traces_share = 1.0))]
    #[allow(clippy::too_many_arguments)] // the settings of a driver
    fn new(
        py: Python<'_>,
        ready: &[u8],
        fleet: &str,
        vehicle: &str,
        gate: BTreeMap<String, f64>,
        budget: f64,
        hedge: f64,
        want_sigma: bool,
        keys: Option<&str>,
        traces: Option<PathBuf>,
        traces_share: f64,
    ) -> PyResult<Self> {
        let config = driver_config(fleet, vehicle, gate, budget, hedge, want_sigma, keys)?;
        let ready = Ready::decode(ready).map_err(raise)?;
        let open = |file| Tracing::open(py, file, traces_share, &config);
        let traces = traces.map(open).transpose()?;
        egp_driver::Driver::new(config, ready)
            .map(|driver| Self(driver, traces))
            .map_err(InvalidArgumentError::raise)
    }

    /// Note that a replica announces itself.
    fn replica_appeared(&mut self, replica: &str) -> PyResult<()> {
        self.0.replica_appeared(name(replica)?);
        Ok(())
    }

    /// Note that the replica that announces itself gave the description with which the driver was made. Any other replica
    /// is asked for steps only after it has answered a query of its `ready` key, which is one of the driver's actions.
    fn replica_fits(&mut self, replica: &str) -> PyResult<()> {
        self.0.replica_fits(&name(replica)?);
        Ok(())
    }

    /// Note that a replica withdrew its announcement or was lost.
    fn replica_gone(&mut self, now: f64, replica: &str) -> PyResult<()> {
        self.0.replica_gone(time(now)?, &name(replica)?);
        Ok(())
    }

    /// Open a control period at the measured state (7,), with a command due by `deadline`.
    ///
    /// `reference` has rows [p_x, p_y, v_x, psi] (T+1, 4), `widths` rows [left, right] (T+1, 2), `road_friction` rows
    /// [friction, standard deviation] (T+2, 2). A state that cannot be used is a stop, whatever the others are. Raises
    /// `InvalidArgumentError` if no request can be made from the arguments; the period then counts as one without a request.
    #[pyo3(signature = (now, deadline, x, reference, widths = None, road_friction = None))]
    fn tick(
        &mut self,
        now: f64,
        deadline: f64,
        x: &Bound<'_, PyAny>,
        reference: &Bound<'_, PyAny>,
        widths: Option<&Bound<'_, PyAny>>,
        road_friction: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let now = time(now)?;
        let given = within(deadline, || {
            measurement(x, reference, widths, road_friction)
        });
        let (deadline, measurement) = given.inspect_err(|_| self.0.skip_period(now))?;
        if let Some(traces) = &mut self.1 {
            traces.began(now);
        }
        let ticked = self.0.tick(now, deadline, measurement);
        ticked.map_err(InvalidArgumentError::raise)
    }

    /// State the present time before an event that came some time ago, so that a hold-up in between is counted.
    fn clock(&mut self, now: f64) -> PyResult<()> {
        self.0.clock(time(now)?);
        Ok(())
    }

    /// Give an open period up because an exception ends the step. The next request has no history, and the
    /// spans of the period are not written.
    fn abandon(&mut self) {
        self.0.abandon();
        if let Some(traces) = &mut self.1 {
            traces.steps.abandon();
        }
    }

    /// When `wake` is due, on the driver's clock; infinite while no period is open.
    #[getter]
    fn next_wake(&self) -> f64 {
        let wake = self.0.next_wake();
        wake.map_or(f64::INFINITY, |at| at.as_secs_f64())
    }

    /// Ask a second replica or decide the open period, if it is time to.
    fn wake(&mut self, now: f64) -> PyResult<()> {
        self.0.wake(time(now)?);
        Ok(())
    }

    /// Note a reply and its attachment.
    fn replied(&mut self, now: f64, query: u64, payload: &[u8], attachment: &[u8]) -> PyResult<()> {
        let (now, query) = (time(now)?, QueryId(query));
        if let Some(traces) = &mut self.1 {
            traces.steps.replied(now, query);
        }
        self.0.replied(now, query, payload, attachment);
        Ok(())
    }

    /// Note an error reply.
    fn refused(&mut self, now: f64, query: u64, error: &[u8]) -> PyResult<()> {
        let (now, query) = (time(now)?, QueryId(query));
        if let Some(traces) = &mut self.1 {
            traces.steps.refused(now, query, error);
        }
        self.0.refused(now, query, error);
        Ok(())
    }

    /// Note that no more answers to a query come.
    fn ended(&mut self, now: f64, query: u64) -> PyResult<()> {
        let (now, query) = (time(now)?, QueryId(query));
        if let Some(traces) = &mut self.1 {
            traces.steps.ended(now, query);
        }
        self.0.ended(now, query);
        Ok(())
    }

    /// Return the next action: a query to send, or the period's decision.
    fn next_action(&mut self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let action = self.0.next_action();
        if let (Some(traces), Some(action)) = (&mut self.1, &action) {
            traces.acted(py, action);
        }
        Ok(match action {
            None => None,
            Some(Action::Command(step)) => Some(Py::new(py, Decision::new(py, *step)?)?.into_any()),
            Some(Action::Ask(query) | Action::Probe(query)) => {
                let query = Query {
                    id: query.id.0,
                    replica: query.replica.to_string(),
                    key: query.key,
                    payload: query.payload.into(),
                    attachment: query.attachment.into(),
                    listen: query.listen.as_secs_f64(),
                };
                Some(Py::new(py, query)?.into_any())
            }
        })
    }

    /// Write the spans that wait and no more, and return how many could not be written, and the system's error, if one was
    /// the reason.
    fn finish_traces(&mut self, py: Python<'_>) -> (u64, Option<String>) {
        let traces = self.1.take();
        traces.map_or((0, None), |traces| traces.finish(py))
    }

    /// Seconds that an answer may take unless a period states its deadline.
    #[getter]
    fn budget(&self) -> f64 {
        self.0.budget().as_secs_f64()
    }

    /// Weights of the newest reply (N,); empty before the first.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.0.weights().iter().copied())
    }

    /// Leave STOP and forget history, weights, plan and outstanding requests.
    fn reset(&mut self) {
        self.0.reset();
        if let Some(traces) = &mut self.1 {
            traces.steps.abandon();
        }
    }
}
