//! The service inside a Python process: one control step by itself, or a whole server.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use egp_core::Settings;
use egp_engine::EngineWorkspace;
use egp_service::{Fetched, ServiceConfig, Wanted, catch_step};
use egp_wire::{Ready, Timing, WireError};
use pyo3::exceptions::{PyKeyboardInterrupt, PySystemExit};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::array::{NewVector, Vector, vector};
use crate::driver::Decision;
use crate::driver_arguments::{driver_config, measurement, within};
use crate::error::{InvalidArgumentError, RefusedError, raise};
use crate::parameters::VehicleParameters;
use crate::problem_export::{Problem, arguments};
use crate::text::list;

/// The control step of the service in this process: the same request gives the same bytes of a reply.
///
/// `settings_toml` holds the settings of the control step; fields left out keep their default, which is 0.5 s for the
/// window and 0.8 s for the horizon, shorter for small vehicles, longer with a member of a friction below 0.5, and at most 120
/// periods. With more than
/// one of `cores` (no more than the machine has), members are evaluated in parallel where that takes half a millisecond or more: standard deviations of four
/// active members of 700 points, for example, but not of two. The bytes of a reply do not depend on `cores`. An engine
/// with several cores does not work in a forked process, which does not inherit its threads. Raises `InvalidArgumentError` for
/// settings out of range, and `EgpError` for a library that cannot be read or that the settings do not fit.
#[pyclass(module = "egp_service._core", frozen)]
pub struct Engine {
    inner: egp_engine::Engine,
    workspace: Mutex<Option<EngineWorkspace>>,
    served: Ready,
}

fn refused(error: &WireError) -> PyErr {
    RefusedError::new_err(format!("{}: {error}", error.code_name()))
}

impl Engine {
    fn answer(&self, request: &[u8]) -> Result<Vec<u8>, WireError> {
        let mut reply = Vec::new();
        let mut workspace = self
            .workspace
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        catch_step(&self.inner, &mut workspace, request, &mut reply, || ())?;
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
        let settings = Settings::from_toml(settings_toml).map_err(InvalidArgumentError::raise)?;
        py.detach(|| {
            let engine = egp_engine::Engine::load(&library_path, settings)
                .and_then(|engine| engine.with_cores(cores))
                .map_err(raise)?;
            let workspace = engine.workspace().map_err(|error| refused(&error))?;
            let served = engine.describe();
            Ok(Self {
                inner: engine,
                workspace: Mutex::new(Some(workspace)),
                served,
            })
        })
    }

    /// Answer one request without the GIL. Raises `RefusedError`, which begins with the error's code.
    fn step(&self, py: Python<'_>, request: &[u8]) -> PyResult<Cow<'static, [u8]>> {
        py.detach(|| self.answer(request))
            .map(Into::into)
            .map_err(|error| refused(&error))
    }

    /// Return the optimal control problem that the step of a request solves, as the arguments of `solve_ocp`.
    fn problem<'py>(&self, py: Python<'py>, request: &[u8]) -> PyResult<Problem<'py>> {
        let solved = py.detach(|| {
            let mut workspace = self.inner.workspace()?;
            self.inner.step(&mut workspace, request, &mut Vec::new())?;
            Ok(workspace)
        });
        let workspace = solved.map_err(|error| refused(&error))?;
        arguments(py, workspace.problem())
    }

    /// Control period in s.
    #[getter]
    fn dt(&self) -> f64 {
        self.served.dt
    }

    /// Inputs in a plan, T.
    #[getter]
    fn horizon(&self) -> u32 {
        self.served.horizon
    }

    /// Largest useful number of transitions in a request, K.
    #[getter]
    fn history(&self) -> u32 {
        self.served.history
    }

    /// SHA-256 of the library file.
    #[getter]
    fn library_id<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.served.library)
    }

    /// Surfaces, in the order of the weights.
    #[getter]
    fn members(&self) -> Vec<String> {
        self.served.members.clone()
    }

    /// Nominal friction coefficients of the members, in the order of the weights.
    #[getter]
    fn frictions(&self) -> Vec<f64> {
        let members = self.inner.library().members().iter();
        members.map(egp_core::Member::friction).collect()
    }

    /// Bytes of the Ready message of a replica with this engine.
    #[getter]
    fn ready<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.served.encode())
    }

    /// The library's vehicle, with the settings' mass and `l_f` in place of its own.
    #[getter]
    fn vehicle(&self) -> VehicleParameters {
        VehicleParameters(self.inner.vehicle())
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let Ready {
            dt,
            horizon,
            history,
            members,
            ..
        } = &self.served;
        let members = list(py, members)?;
        Ok(format!(
            "Engine(members={members}, dt={dt:?}, horizon={horizon}, history={history})"
        ))
    }

    /// All settings, defaults included.
    #[getter]
    fn settings_toml(&self) -> PyResult<String> {
        self.inner.settings().to_toml().map_err(raise)
    }
}

/// A `Driver` whose answers an engine of this process computes.
#[pyclass(module = "egp_service._core")]
pub struct InProcessDriver {
    driver: egp_driver::InProcessDriver,
    engine: Py<Engine>,
}

#[pymethods]
impl InProcessDriver {
    #[new]
    #[pyo3(signature = (engine, *, gate, want_sigma = false))]
    fn new(engine: Py<Engine>, gate: BTreeMap<String, f64>, want_sigma: bool) -> PyResult<Self> {
        // There is one replica only, so that no query is hedged.
        let config = driver_config("in-process", "vehicle", gate, 0.8, 1.0, want_sigma, None)?;
        let served = engine.get().served.clone();
        let driver = egp_driver::InProcessDriver::new(config, served)
            .map_err(InvalidArgumentError::raise)?;
        Ok(Self { driver, engine })
    }

    /// Decide one control period; see `Driver.tick`. `budget` is only stated in the request.
    #[pyo3(signature = (budget, x, reference, widths = None, road_friction = None))]
    fn step(
        &mut self,
        py: Python<'_>,
        budget: f64,
        x: &Bound<'_, PyAny>,
        reference: &Bound<'_, PyAny>,
        widths: Option<&Bound<'_, PyAny>>,
        road_friction: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Decision> {
        let given = within(budget, || measurement(x, reference, widths, road_friction));
        let (budget, measurement) = given.inspect_err(|_| self.driver.skip_period())?;
        let (driver, engine) = (&mut self.driver, self.engine.get());
        let step = py.detach(|| {
            driver.step(measurement, budget, |request| {
                let start = Instant::now();
                let reply = engine.answer(request)?;
                let step_us = u32::try_from(start.elapsed().as_micros()).unwrap_or(u32::MAX);
                Ok((
                    reply,
                    Timing {
                        queue_us: 0,
                        step_us,
                        ..Timing::default()
                    },
                ))
            })
        });
        Decision::new(py, step.map_err(InvalidArgumentError::raise)?)
    }

    /// Note that the last step's command was not given, because an exception ended the step.
    fn abandon(&mut self) {
        self.driver.driver_mut().abandon();
    }

    /// Budget in s that requests state if the period has none of its own.
    #[getter]
    fn budget(&self) -> f64 {
        self.driver.driver().budget().as_secs_f64()
    }

    /// Weights of the newest reply (N,); empty before the first.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> NewVector<'py> {
        vector(py, self.driver.driver().weights().iter().copied())
    }

    /// Start the next request from these weights instead of the last reply's.
    fn start_from(&mut self, weights: Vector<'_>) {
        let weights = weights.as_array().iter().copied().collect();
        self.driver.driver_mut().start_from(weights);
    }

    /// Start the next request from these weights, and carry no history from now on.
    fn hold_weights(&mut self, weights: Vector<'_>) {
        let weights = weights.as_array().iter().copied().collect();
        self.driver.driver_mut().hold_weights(weights);
    }

    /// Leave STOP and forget history, weights and plan.
    fn reset(&mut self) {
        self.driver.driver_mut().reset();
    }
}

/// A service that runs in this process until it is stopped; a context manager.
///
/// `config_toml` is the text of the file for `egp-server --config`; relative paths start at the working folder.
#[pyclass(module = "egp_service._core", frozen)]
pub struct Server(Mutex<Option<egp_service::Server>>);

#[pymethods]
impl Server {
    #[new]
    fn new(py: Python<'_>, config_toml: &str) -> PyResult<Self> {
        let config = ServiceConfig::from_toml(config_toml).map_err(raise)?;
        let start =
            |stopped: &mut dyn FnMut() -> bool| egp_service::Server::start_unless(&config, stopped);
        Ok(Self(Mutex::new(Some(until_signal(py, start)?))))
    }

    /// Withdraw the announcement, answer the requests that wait, and close.
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

/// Serve until SIGTERM or Ctrl-C, then drain; the same as `egp-server --config`.
#[pyfunction]
pub fn serve(py: Python<'_>, config_toml: &str) -> PyResult<()> {
    let config = ServiceConfig::from_toml(config_toml).map_err(raise)?;
    // A signal that came before is one for Python's handlers, and a later one is for the service.
    let signals = egp_service::ServiceSignals::register().map_err(raise)?;
    py.check_signals()?;
    let ended = py.detach(|| egp_service::serve(&config, signals));
    after_signal(py)?;
    ended.map_err(raise)
}

/// Fetch the library with this SHA-256 (64 hexadecimal digits) from any replica that the zenoh settings of `network_toml`
/// connect to, and return the replica's name; `None` if `path` holds the library already.
///
/// `network_toml` is the text of a service's configuration, of which only `zenoh_file` and `zenoh` are used. Hash, the
/// signature if a file of public keys is given, and the library itself are checked before `path` is replaced. Raises
/// `EgpError` with each replica's reason if none of them gave the library within `timeout` seconds.
#[pyfunction]
#[pyo3(signature = (sha256, path, network_toml, *, library_keys = None, timeout = 10.0))]
pub fn fetch_library(
    py: Python<'_>,
    sha256: &str,
    path: PathBuf,
    network_toml: &str,
    library_keys: Option<PathBuf>,
    timeout: f64,
) -> PyResult<Option<String>> {
    let id = egp_wire::from_hex(sha256).ok_or_else(|| {
        InvalidArgumentError::raise(format!(
            "sha256: expected 64 hexadecimal digits, got {sha256:?}; `egp inspect` shows a library's"
        ))
    })?;
    let patience = Duration::try_from_secs_f64(timeout).map_err(|_| {
        InvalidArgumentError::raise(format!("timeout: expected seconds, got {timeout}"))
    })?;
    let network = ServiceConfig::from_toml(network_toml).map_err(raise)?;
    let wanted = Wanted {
        id,
        file: &path,
        keys: library_keys.as_deref(),
    };
    let fetch = |stopped: &mut dyn FnMut() -> bool| wanted.fetch(&network, patience, stopped);
    Ok(match until_signal(py, fetch)? {
        Fetched::Already => None,
        Fetched::From(replica) => Some(replica.to_string()),
    })
}

/// Lets other threads of Python run during `work`, which gets a function that says whether to give up: after a signal,
/// whose exception is then the result.
fn until_signal<T: Send, E: Display + Send>(
    py: Python<'_>,
    work: impl FnOnce(&mut dyn FnMut() -> bool) -> Result<T, E> + Send,
) -> PyResult<T> {
    let mut signal = None;
    let done = py.detach(|| {
        work(&mut || {
            signal = signal
                .take()
                .or_else(|| Python::attach(|py| py.check_signals().err()));
            signal.is_some()
        })
    });
    match signal {
        Some(signal) => Err(signal),
        None => done.map_err(raise),
    }
}

/// Discards the exception that Python's own handler of a signal raises once a service has ended because of the signal.
pub fn after_signal(py: Python<'_>) -> PyResult<()> {
    match py.check_signals() {
        Err(error)
            if !error.is_instance_of::<PyKeyboardInterrupt>(py)
                && !error.is_instance_of::<PySystemExit>(py) =>
        {
            Err(error)
        }
        _ => Ok(()),
    }
}
