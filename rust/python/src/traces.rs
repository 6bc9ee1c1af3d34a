//! The spans of control steps for Python's transports.

use std::path::PathBuf;
use std::time::Duration;

use egp_driver::{Action, DriverConfig};
use egp_vehicle::StepTraces;
use pyo3::prelude::*;

use crate::error::InvalidArgumentError;

/// What a driver's transport tells about its periods, on the clock `time.monotonic`.
pub struct Tracing {
    /// What happens to the questions.
    pub steps: StepTraces,
    began: Duration,
    monotonic: Py<PyAny>,
}

impl Tracing {
    /// Opens the file.
    pub fn open(
        py: Python<'_>,
        file: PathBuf,
        share: f64,
        config: &DriverConfig,
    ) -> PyResult<Self> {
        let steps = StepTraces::open(&file, share, &config.fleet, &config.vehicle);
        Ok(Self {
            steps: steps.map_err(InvalidArgumentError::raise)?,
            began: Duration::ZERO,
            monotonic: py.import("time")?.getattr("monotonic")?.unbind(),
        })
    }

    /// A control period begins.
    pub fn began(&mut self, at: Duration) {
        self.began = at;
    }

    /// The driver asks a replica, or decides the period.
    pub fn acted(&mut self, py: Python<'_>, action: &Action) {
        let clock = || {
            let seconds = self.monotonic.call0(py).and_then(|time| time.extract(py));
            seconds.map_or(Duration::ZERO, |seconds| {
                Duration::try_from_secs_f64(seconds).unwrap_or_default()
            })
        };
        let now = clock();
        match action {
            Action::Ask(query) => self.steps.asked(now, query),
            Action::Command(step) => self.steps.decided(self.began, now, step, clock),
            Action::Probe(_) => {}
        }
    }

    /// Writes what waits, and returns how many spans could not be written, and the system's error, if one was the reason.
    pub fn finish(self, py: Python<'_>) -> (u64, Option<String>) {
        let counts = self.steps.counts();
        py.detach(|| drop(self.steps));
        (counts.dropped() + counts.failed(), counts.last_error())
    }
}
