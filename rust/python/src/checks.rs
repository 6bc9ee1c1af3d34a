//! What programs check before they start, and what they say about the machine.

use std::path::PathBuf;

use egp_core::Settings;
use egp_service::ServiceConfig;
use pyo3::prelude::*;

use crate::error::{InvalidArgumentError, raise};
use crate::wire::Replica;

/// Check all that a service needs to start, as `egp-server --check` does. Return what it would serve, and warnings: of a
/// certificate that expires within 30 days, and of secret keys that every user of the machine may use.
#[pyfunction]
pub fn check_service(py: Python<'_>, config_toml: &str) -> PyResult<(Replica, Vec<String>)> {
    let config = ServiceConfig::from_toml(config_toml).map_err(raise)?;
    let checked = (py.detach(|| egp_service::check(&config))).map_err(raise)?;
    Ok((Replica::of(py, checked.served)?, checked.warnings))
}

/// The vector instructions that Gaussian processes use on this machine: `AVX-512`, `AVX2`, `NEON` or `none`.
#[pyfunction]
pub fn vector_instructions() -> &'static str {
    egp_core::vector_instructions()
}

/// Why zenoh does not accept a setting or a file, from the text of its error; without what the error quotes, which may be
/// secret.
#[pyfunction]
pub fn refused_setting(error: &str) -> String {
    egp_session::refused(error)
}

/// Check the certificates of a zenoh configuration file for a role such as `router`, and return a warning if one of them
/// expires within 30 days, otherwise `None`. Raise `EgpError` if one cannot be used.
#[pyfunction]
pub fn check_certificates(file: PathBuf, role: &str) -> PyResult<Option<String>> {
    egp_service::check_certificates(&file, role).map_err(raise)
}

/// The number of cores that this process may use, by its affinity and the quotas of its cgroups.
#[pyfunction]
pub fn available_cores() -> usize {
    egp_engine::available_cores()
}

/// Raise `InvalidArgumentError`, with the line and the key, for settings of the control step that cannot be used with any
/// library.
#[pyfunction]
pub fn check_settings(settings_toml: &str) -> PyResult<()> {
    Settings::from_toml(settings_toml)
        .map(drop)
        .map_err(InvalidArgumentError::raise)
}
