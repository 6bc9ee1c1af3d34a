//! The service inside a Python process: one control step by itself, or a whole server.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use egp_core::Settings;
use egp_engine::EngineWorkspace;
use egp_service::ServiceConfig;
use egp_wire::{Ready, Timing, WireError};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::array::{Matrix, NewVector, Vector, vector};
use crate::driver::{Decision, driver_config, measurement};
use crate::error::{InvalidArgumentError, RefusedError, raise};
use crate::gate::mode_name;
use crate::parameters::VehicleParameters;

/// The control step of the service, in-process: the same bytes in, the same bytes out.
#[pyclass(module = "egp_service._core", frozen)]
struct Engine {
    inner: egp_engine::Engine,
    workspace: Mutex<EngineWorkspace>,
    served: Ready,
}

fn refused(error: &WireError) -> PyErr {
    RefusedError::new_err(format!("{}: {error}", error.code_name()))
}

impl Engine {
    fn answer(&self, request: &[u8]) -> Result<Vec<u8>, WireError> {
        let mut reply = Vec::new();
        // A step that panicked left numbers behind that the next one overwrites before use.
        let mut workspace = self
            .workspace
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        self.inner.step(&mut workspace, request, &mut reply)?;
        Ok(reply)
    }
}

#[pymethods]
impl Engine {
    #[new]
    #[pyo3(signature = (library_path, settings_toml = "", *, cores = 1))]
    fn new(
        py: Python<'_>,
        library_path: PathBuf,
        settings_toml: &str,
        cores: usize,
    ) -> PyResult<Self> {
        let settings = Settings::from_toml(settings_toml).map_err(raise)?;
        py.detach(|| {
            let engine = egp_engine::Engine::load(&library_path, settings)
                .and_then(|engine| engine.with_cores(cores))
                .map_err(raise)?;
            let workspace = engine.workspace().map_err(|error| refused(&error))?;
            let served = engine.describe();
            Ok(Self {
                inner: engine,
                workspace: Mutex::new(workspace),
                served,
            })
        })
    }

    fn step(&self, py: Python<'_>, request: &[u8]) -> PyResult<Cow<'static, [u8]>> {
        py.detach(|| self.answer(request))
            .map(Into::into)
            .map_err(|error| refused(&error))
    }

    #[getter]
    fn dt(&self) -> f64 {
        self.served.dt
    }

    #[getter]
    fn horizon(&self) -> u32 {
        self.served.horizon
    }

    #[getter]
    fn history(&self) -> u32 {
        self.served.history
    }

    #[getter]
    fn library_id<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.served.library)
    }

    #[getter]
    fn members(&self) -> Vec<String> {
        self.served.members.clone()
    }

    #[getter]
    fn ready<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.served.encode())
    }

    #[getter]
    fn vehicle(&self) -> VehicleParameters {
        VehicleParameters(self.inner.vehicle())
    }

    #[getter]
    fn settings_toml(&self) -> PyResult<String> {
        self.inner.settings().to_toml().map_err(raise)
    }
}

/// A driver whose answers an engine of this process computes.
#[pyclass(module = "egp_service._core")]
struct InProcessDriver {
    driver: egp_driver::InProcessDriver,
    engine: Py<Engine>,
}

#[pymethods]
impl InProcessDriver {
    #[new]
    #[pyo3(signature = (engine, *, gate, want_sigma = false))]
    fn new(engine: Py<Engine>, gate: BTreeMap<String, f64>, want_sigma: bool) -> PyResult<Self> {
        let config = driver_config("in-process", "vehicle", gate, 0.8, want_sigma)?;
        let served = engine.get().served.clone();
        let driver = egp_driver::InProcessDriver::new(config, served)
            .map_err(InvalidArgumentError::raise)?;
        Ok(Self { driver, engine })
    }

    #[pyo3(signature = (budget, x, reference, widths = None))]
    fn step(
        &mut self,
        py: Python<'_>,
        budget: f64,
        x: Vector<'_>,
        reference: Matrix<'_>,
        widths: Option<Matrix<'_>>,
    ) -> PyResult<Decision> {
        let measurement = measurement(&x, &reference, widths.as_ref())?;
        let budget = Duration::try_from_secs_f64(budget).map_err(InvalidArgumentError::raise)?;
        let (driver, engine) = (&mut self.driver, self.engine.get());
        py.detach(|| {
            driver.step(measurement, budget, |request| {
                let start = Instant::now();
                let reply = engine.answer(request)?;
                let step_us = u32::try_from(start.elapsed().as_micros()).unwrap_or(u32::MAX);
                Ok((
                    reply,
                    Timing {
                        queue_us: 0,
                        step_us,
                    },
                ))
            })
        })
        .map(Decision)
        .map_err(InvalidArgumentError::raise)
    }

    #[getter]
    fn budget(&self) -> f64 {
        self.driver.driver().budget().as_secs_f64()
    }

    #[getter]
    fn mode(&self) -> &'static str {
        mode_name(self.driver.driver().mode())
    }

    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.driver.driver().weights().iter().copied())
    }

    fn start_from(&mut self, weights: Vector<'_>) {
        let weights = weights.as_array().iter().copied().collect();
        self.driver.driver_mut().start_from(weights);
    }

    fn hold_weights(&mut self, weights: Vector<'_>) {
        let weights = weights.as_array().iter().copied().collect();
        self.driver.driver_mut().hold_weights(weights);
    }

    fn reset(&mut self) {
        self.driver.driver_mut().reset();
    }
}

/// A server that runs in this process until it is stopped.
#[pyclass(module = "egp_service._core", frozen)]
struct Server(Mutex<Option<egp_service::Server>>);

#[pymethods]
impl Server {
    #[new]
    fn new(py: Python<'_>, config_toml: &str) -> PyResult<Self> {
        let config = ServiceConfig::from_toml(config_toml).map_err(raise)?;
        let server = py
            .detach(|| egp_service::Server::start(&config))
            .map_err(raise)?;
        Ok(Self(Mutex::new(Some(server))))
    }

    fn stop(&self, py: Python<'_>) {
        let server = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(server) = server {
            py.detach(|| server.drain());
        }
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, pyo3::types::PyTuple>) {
        self.stop(py);
    }
}

#[pyfunction]
fn serve(py: Python<'_>, config_toml: &str) -> PyResult<()> {
    let config = ServiceConfig::from_toml(config_toml).map_err(raise)?;
    py.detach(|| egp_service::serve(&config)).map_err(raise)?;
    // Ctrl-C has done its work by draining; Python has noted it as well.
    match py.check_signals() {
        Err(error) if !error.is_instance_of::<PyKeyboardInterrupt>(py) => Err(error),
        _ => Ok(()),
    }
}

/// Adds the classes and functions to the module.
///
/// # Errors
/// Errors if the module does not accept the name.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Engine>()?;
    module.add_class::<InProcessDriver>()?;
    module.add_class::<Server>()?;
    module.add_function(wrap_pyfunction!(serve, module)?)
}
