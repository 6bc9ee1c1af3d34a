//! The map service.

use egp_service::map::MapConfig;
use pyo3::prelude::*;

use crate::error::raise;
use crate::service::after_signal;

/// Keep a map until SIGTERM, SIGHUP or Ctrl-C; `config_toml` is described in docs/settings.md. Raises `EgpError` if it does
/// not start, or if a road is not written at the end.
#[pyfunction]
pub fn serve_map(py: Python<'_>, config_toml: &str) -> PyResult<()> {
    let config = MapConfig::from_toml(config_toml).map_err(raise)?;
    // A signal that came before is one for Python's handlers, and a later one is for the service.
    let signals = egp_service::ServiceSignals::register_for_map().map_err(raise)?;
    py.check_signals()?;
    let ended = py.detach(|| egp_service::map::serve_map(&config, signals));
    after_signal(py)?;
    ended.map_err(raise)
}

/// Check what a map service needs to start, except its folder. Return a warning if one of its certificates expires within 30
/// days, otherwise `None`. Raises `EgpError` as `serve_map` does.
#[pyfunction]
pub fn check_map(py: Python<'_>, config_toml: &str) -> PyResult<Option<String>> {
    let config = MapConfig::from_toml(config_toml).map_err(raise)?;
    (py.detach(|| egp_service::map::check_map(&config))).map_err(raise)
}
