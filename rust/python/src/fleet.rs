//! The exchange with a fleet's map, for Python's transport.

use std::borrow::Cow;
use std::collections::BTreeMap;

use egp_driver::{FleetAction, FleetSettings, QueryId};
use egp_wire::road_keys::RoadKey;
use pyo3::IntoPyObjectExt as _;
use pyo3::prelude::*;

use crate::belief::RoadBelief;
use crate::driver_arguments::time;
use crate::error::InvalidArgumentError;
use crate::wire::name;

/// A question or evidence for the map service, to be sent as it is.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct MapQuery {
    /// Identifies the query to the exchange.
    id: u64,
    /// Key of the zenoh query.
    key: String,
    /// Bytes to send; None for a question.
    payload: Option<Cow<'static, [u8]>>,
    /// Time to listen for the answer, s.
    listen: f64,
}

/// Something that an engineer may want to know, to be logged.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct FleetNotice {
    /// What it is, in one sentence.
    text: String,
    /// Whether something is wrong; otherwise there is only no map service.
    is_warning: bool,
}

/// Decides for one vehicle what to send to a fleet's map, what to ask it, and what to use of its answers.
///
/// A state machine without clock, network or threads: it is told each event with the time in s of a clock that does not run
/// backwards, and its actions are to be carried out. `belief` is the vehicle's belief about the road, which must not be in use
/// during a call. `lifetime`, s, is that of the service, `timeout`, s, the time that an answer, `fetch` and `finish` may take.
/// Raises `InvalidArgumentError` for a text that is no name, and for values out of range.
#[pyclass(module = "egp_service._core")]
pub struct FleetExchange(egp_driver::FleetExchange, Py<RoadBelief>);

#[pymethods]
impl FleetExchange {
    #[new]
    #[pyo3(signature = (now, belief, *, fleet, vehicle, road, lifetime, timeout))]
    #[allow(clippy::too_many_arguments)] // the settings of an exchange
    fn new(
        now: f64,
        belief: Bound<'_, RoadBelief>,
        fleet: &str,
        vehicle: &str,
        road: &str,
        lifetime: f64,
        timeout: f64,
    ) -> PyResult<Self> {
        let road = RoadKey {
            fleet: name(fleet)?,
            vehicle: name(vehicle)?,
            road: name(road)?,
        };
        let timeout = time(timeout)?;
        let settings = FleetSettings { lifetime, timeout };
        let own = &mut belief.try_borrow_mut()?.0;
        egp_driver::FleetExchange::new(road, settings, time(now)?, own)
            .map(|exchange| Self(exchange, belief.clone().unbind()))
            .map_err(InvalidArgumentError::raise)
    }

    /// The key of the service's publications about the road.
    #[getter]
    fn publications(&self) -> String {
        self.0.publications()
    }

    /// Ask for all tiles, again if there is no answer.
    fn fetch(&mut self, now: f64) -> PyResult<()> {
        self.0.fetch(time(now)?);
        Ok(())
    }

    /// Send the last evidence, unless the service is silent.
    fn finish(&mut self, py: Python<'_>, now: f64) -> PyResult<()> {
        let mut belief = self.1.try_borrow_mut(py)?;
        self.0.finish(time(now)?, &mut belief.0);
        Ok(())
    }

    /// When `wake` is due while `fetch` or `finish` goes on; otherwise None.
    #[getter]
    fn next_wake(&self) -> Option<f64> {
        self.0.next_wake().map(|at| at.as_secs_f64())
    }

    /// State the present time while `fetch` or `finish` goes on.
    fn wake(&mut self, py: Python<'_>, now: f64) -> PyResult<()> {
        let mut belief = self.1.try_borrow_mut(py)?;
        self.0.wake(time(now)?, &mut belief.0);
        Ok(())
    }

    /// Do what is due; to be called once in each control period, after the events since the last one.
    fn period(&mut self, py: Python<'_>, now: f64) -> PyResult<()> {
        let mut belief = self.1.try_borrow_mut(py)?;
        self.0.period(time(now)?, &mut belief.0);
        Ok(())
    }

    /// Note that the service published that tiles of the road have new evidence.
    fn changed(&mut self, publication: &[u8]) {
        self.0.changed(publication);
    }

    /// Note that there was no room for publications, so that any tile may have new evidence.
    fn publications_lost(&mut self) {
        self.0.publications_lost();
    }

    /// Note a reply to a query.
    fn replied(&mut self, py: Python<'_>, now: f64, query: u64, answer: &[u8]) -> PyResult<()> {
        let mut belief = self.1.try_borrow_mut(py)?;
        self.0
            .replied(time(now)?, QueryId(query), answer, &mut belief.0);
        Ok(())
    }

    /// Note an error reply to a query.
    fn refused(&mut self, query: u64, error: &[u8]) {
        self.0.refused(QueryId(query), error);
    }

    /// Note that no more answers to a query come.
    fn ended(&mut self, py: Python<'_>, now: f64, query: u64) -> PyResult<()> {
        let mut belief = self.1.try_borrow_mut(py)?;
        self.0.ended(time(now)?, QueryId(query), &mut belief.0);
        Ok(())
    }

    /// Return the next query or notice, or None if there is nothing to do.
    fn next_action(&mut self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let action = self.0.next_action().map(|action| match action {
            FleetAction::Ask(query) => MapQuery {
                id: query.id.0,
                key: query.key,
                payload: query.payload.map(Cow::from),
                listen: query.listen.as_secs_f64(),
            }
            .into_py_any(py),
            FleetAction::Notice(notice) => FleetNotice {
                text: notice.to_string(),
                is_warning: notice.is_warning(),
            }
            .into_py_any(py),
        });
        action.transpose()
    }

    /// Whether a map service has answered a question about the road.
    #[getter]
    fn answered(&self) -> bool {
        self.0.answered()
    }

    /// Whether no map service replied to the last query, not even with an error.
    #[getter]
    fn silent(&self) -> bool {
        self.0.silent()
    }

    /// Return the number of tiles whose newest evidence no map service has acknowledged.
    fn unsent(&mut self, py: Python<'_>, now: f64) -> PyResult<usize> {
        let mut belief = self.1.try_borrow_mut(py)?;
        Ok(self.0.unsent(time(now)?, &mut belief.0))
    }

    /// Return the vehicles whose evidence was reported, each with the age of its newest measurement in s.
    fn origins(&self, now: f64) -> PyResult<BTreeMap<String, f64>> {
        let origins = self.0.origins(time(now)?).into_iter();
        Ok(origins
            .map(|(vehicle, age)| (vehicle.to_string(), age.as_secs_f64()))
            .collect())
    }
}
