//! The search for a replica, for Python's transports.

use std::borrow::Cow;
use std::collections::BTreeMap;

use egp_driver::Discovery;
use pyo3::prelude::*;

use crate::driver_arguments::driver_config;
use crate::error::InvalidArgumentError;
use crate::wire::name;

/// Finds a replica that is ready by asking those that announce themselves in turn.
#[pyclass(name = "Discovery", module = "egp_service._core")]
pub struct Discover(Discovery);

#[pymethods]
impl Discover {
    #[new]
    #[pyo3(signature = (*, fleet, vehicle, gate, budget = 0.8, hedge = 0.5, keys = None))]
    fn new(
        fleet: &str,
        vehicle: &str,
        gate: BTreeMap<String, f64>,
        budget: f64,
        hedge: f64,
        keys: Option<&str>,
    ) -> PyResult<Self> {
        let config = driver_config(fleet, vehicle, gate, budget, hedge, false, keys)?;
        Discovery::new(&config)
            .map(Self)
            .map_err(InvalidArgumentError::raise)
    }

    /// Note that a replica announces itself.
    fn replica_appeared(&mut self, replica: &str) -> PyResult<()> {
        self.0.replica_appeared(name(replica)?);
        Ok(())
    }

    /// Note that a replica withdrew its announcement or was lost.
    fn replica_gone(&mut self, replica: &str) -> PyResult<()> {
        self.0.replica_gone(&name(replica)?);
        Ok(())
    }

    /// The replicas that announce themselves.
    #[getter]
    fn live(&self) -> Vec<String> {
        self.0.live().map(ToString::to_string).collect()
    }

    /// Return a replica to ask, the key, and the bytes to attach, or None if all were asked in this round.
    fn next_question(&mut self) -> Option<(String, String, Cow<'static, [u8]>)> {
        let question = self.0.next_question()?;
        Some((
            question.replica.to_string(),
            question.key,
            question.attachment.into(),
        ))
    }

    /// Whether an answer describes a replica that can be used; otherwise the reason is kept.
    ///
    /// A replica can be used if its description is valid and says that it is ready, if the vehicle has a key or the replica
    /// asks for none, if the gate allows no more than the vehicle that the replica plans for can do, and if the attachment has
    /// the tag of the vehicle's key, if there is one.
    fn is_usable(&mut self, replica: &str, answer: &[u8], attachment: &[u8]) -> PyResult<bool> {
        let replica = name(replica)?;
        Ok(self.0.answered(&replica, answer, attachment).is_some())
    }

    /// Why no replica can be used, in one sentence.
    #[getter]
    fn error(&self) -> String {
        self.0.error().to_string()
    }

    /// The live replicas, each with the reason why it cannot be used.
    #[getter]
    fn unusable(&self) -> BTreeMap<String, String> {
        let reasons = self.0.error().0.into_iter();
        reasons
            .map(|(replica, reason)| (replica.to_string(), reason.to_string()))
            .collect()
    }
}
