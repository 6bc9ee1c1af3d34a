//! The service inside a Python process: one control step by itself, or a whole server.

use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use egp_core::Settings;
use egp_service::{EngineWorkspace, ServiceConfig, Stepper as _};
use egp_wire::{Ready, WireError};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::error::raise;
use crate::parameters::VehicleParameters;

/// The control step of the service, in-process: the same bytes in, the same bytes out.
#[pyclass(name = "Engine", module = "egp_service._core", frozen)]
struct Controller {
    engine: egp_service::Engine,
    workspace: Mutex<EngineWorkspace>,
    served: Ready,
}

fn refused(error: &WireError) -> PyErr {
    let code = error.code.as_str_name().trim_start_matches("CODE_");
    raise(format!("{}: {error}", code.to_ascii_lowercase()))
}

#[pymethods]
impl Controller {
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
            let engine = egp_service::Engine::load(&library_path, settings)
                .and_then(|engine| engine.with_cores(cores))
                .map_err(raise)?;
            let workspace = engine.workspace().map_err(|error| refused(&error))?;
            let served = engine.describe();
            Ok(Self {
                engine,
                workspace: Mutex::new(workspace),
                served,
            })
        })
    }

    fn step(&self, py: Python<'_>, request: &[u8]) -> PyResult<Cow<'static, [u8]>> {
        let mut reply = Vec::new();
        py.detach(|| {
            // A step that panicked left numbers behind that the next one overwrites before use.
            let mut workspace = self
                .workspace
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            self.engine.step(&mut workspace, request, &mut reply)
        })
        .map(|_| reply.into())
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
    fn vehicle(&self) -> VehicleParameters {
        let settings = self.engine.settings();
        VehicleParameters(settings.vehicle(self.engine.library().vehicle()))
    }

    #[getter]
    fn settings_toml(&self) -> PyResult<String> {
        self.engine.settings().to_toml().map_err(raise)
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
/// When Python refuses one.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Controller>()?;
    module.add_class::<Server>()?;
    module.add_function(wrap_pyfunction!(serve, module)?)
}
