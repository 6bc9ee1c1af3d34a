//! The service's configuration file.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use egp_core::Settings;
use egp_engine::available_cores;
use egp_trace::Share;
use egp_wire::{LibraryId, Ready, from_hex, keys::Name, read_text};
use serde::Deserialize;
use serde::de::{Deserializer, Error as _};

use crate::config_error::ConfigError;

/// The configuration of a service, in TOML. Unknown keys are errors.
///
/// ```
/// let config = egp_service::ServiceConfig::from_toml(r#"
///     library = "surfaces.safetensors"
///     replica = "garage-1"
///     [settings.cost]
///     lateral = 30.0
///     [zenoh]
///     "listen/endpoints" = '["tcp/0.0.0.0:7447"]'
/// "#)?;
/// assert_eq!(config.settings.cost.lateral, Some(30.0));
/// # Ok::<(), egp_service::ConfigError>(())
/// ```
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServiceConfig {
    /// The library file; a relative path starts at the folder of the configuration file.
    pub library: PathBuf,
    /// Further library files, for requests that state their hash. Default none.
    pub libraries: Vec<PathBuf>,
    /// SHA-256 of the library, as 64 hexadecimal digits. If `library` does not hold it at the start, it is fetched from the
    /// replicas that the zenoh settings connect to, and replaces the file. Default: none.
    pub fetch: Option<String>,
    /// Libraries that are served at a time, those included that a reload replaced. Default 4.
    pub max_libraries: usize,
    /// Time between looks at the library file, which is loaded again when it changed, ms. Default 0: only when the process
    /// gets SIGHUP.
    pub watch_ms: u64,
    /// Name of this replica, unique among those the vehicles can reach. Default `main`.
    pub replica: String,
    /// Threads that run control steps; steps with much to evaluate also use idle cores. Default: one for each core.
    pub workers: Option<usize>,
    /// Vehicles that may wait at a time; requests of more get the error `overloaded`. Default 256.
    pub queue: usize,
    /// Time between withdrawing the announcement and answering queries with an error while draining, ms. Default 50.
    pub drain_ms: u64,
    /// Time between load reports, ms. Default 500.
    pub load_ms: u64,
    /// Address for `/health`, `/ready` and `/metrics` over HTTP, such as `127.0.0.1:9464`. Default: none.
    #[serde(deserialize_with = "address")]
    pub http: Option<SocketAddr>,
    /// What to log: a level, or directives such as `egp_service=debug,zenoh=warn`. By default it is the level info, and of
    /// zenoh only warnings and errors, without its warnings about single strangers, their queries, and attempts to connect.
    pub log: String,
    /// Whether each log line is a JSON object instead of text. Default false.
    pub log_json: bool,
    /// File to which the spans of requests are appended, which `docs/deploying.md` describes. Default: none.
    pub traces: Option<PathBuf>,
    /// Share of the traces that is written, from 0 to 1. Vehicles with the same share write the same traces. Default 1.
    pub traces_share: f64,
    /// Settings of the control step.
    pub settings: Settings,
    /// File with the secret keys of the vehicles, made by `egp keys`. With it, only requests that are sealed with their
    /// vehicle's key are answered.
    pub vehicle_keys: Option<PathBuf>,
    /// File with the public keys of those who may sign libraries, made by `egp keys`. With it, a library is served only if
    /// the file beside it, with `.sig` behind its name, has a signature by one of the keys (`egp sign`).
    pub library_keys: Option<PathBuf>,
    /// A zenoh JSON5 file that replaces this service's defaults.
    pub zenoh_file: Option<PathBuf>,
    /// Single zenoh settings, key path to JSON5 value; they override the defaults or the file.
    pub zenoh: BTreeMap<String, String>,
}

/// The default filter of the log of both kinds of service.
pub(crate) const DEFAULT_LOG: &str = "info,zenoh=warn,zenoh_link_tls=error,zenoh::net::routing::dispatcher::queries=error,zenoh::net::runtime::orchestrator=error";

/// The default values, with an empty path of the library.
impl Default for ServiceConfig {
    fn default() -> Self {
        Self::new("")
    }
}

impl ServiceConfig {
    /// A configuration with defaults for everything but the library.
    pub fn new(library: impl Into<PathBuf>) -> Self {
        Self {
            library: library.into(),
            libraries: Vec::new(),
            fetch: None,
            max_libraries: 4,
            watch_ms: 0,
            replica: "main".to_owned(),
            workers: None,
            queue: 256,
            drain_ms: 50,
            load_ms: 500,
            http: None,
            log: DEFAULT_LOG.to_owned(),
            log_json: false,
            traces: None,
            traces_share: 1.0,
            settings: Settings::default(),
            vehicle_keys: None,
            library_keys: None,
            zenoh_file: None,
            zenoh: BTreeMap::new(),
        }
    }

    /// The number of threads that run control steps.
    pub(crate) fn workers(&self) -> usize {
        self.workers.unwrap_or_else(available_cores)
    }

    /// The time between looks at the library file; none if it is loaded again on command only.
    pub(crate) fn watch(&self) -> Option<Duration> {
        (self.watch_ms > 0).then(|| Duration::from_millis(self.watch_ms))
    }

    /// The library that is to be in the file before it is served, if the configuration states one.
    pub(crate) fn wanted(&self) -> Option<LibraryId> {
        self.fetch.as_deref().and_then(from_hex)
    }

    /// The share of the traces that is written.
    ///
    /// # Errors
    /// [`ConfigError::Share`].
    pub(crate) fn share(&self) -> Result<Share, ConfigError> {
        Ok(Share::new(self.traces_share)?)
    }

    /// The name of this replica.
    ///
    /// # Errors
    /// [`ConfigError::Range`].
    pub(crate) fn name(&self) -> Result<Name, ConfigError> {
        let expected = "1 to 64 of A-Z a-z 0-9 . _ -";
        let wrong = |_| ConfigError::range("replica", expected, &self.replica);
        self.replica.parse().map_err(wrong)
    }

    /// Reads and validates a configuration.
    ///
    /// # Errors
    /// [`ConfigError`] naming the key at fault.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text)?;
        if config.library.as_os_str().is_empty() {
            return Err(ConfigError::Toml("missing field `library`".to_owned()));
        }
        config.validate()?;
        Ok(config)
    }

    /// Reads a configuration file; relative paths in it start at its folder.
    ///
    /// # Errors
    /// [`ConfigError`] naming the file or the key at fault.
    pub fn from_file(path: &Path) -> Result<Self, ConfigError> {
        let name = || path.display().to_string();
        let text = read_text(path).map_err(|source| ConfigError::Read {
            path: name(),
            source,
        })?;
        let mut config = Self::from_toml(&text).map_err(|source| ConfigError::File {
            path: name(),
            source: Box::new(source),
        })?;
        if let Some(folder) = path.parent() {
            config.library = folder.join(&config.library);
            for library in &mut config.libraries {
                *library = folder.join(&library);
            }
            config.vehicle_keys = config.vehicle_keys.map(|file| folder.join(file));
            config.library_keys = config.library_keys.map(|file| folder.join(file));
            config.traces = config.traces.map(|file| folder.join(file));
            config.zenoh_file = config.zenoh_file.map(|file| folder.join(file));
        }
        Ok(config)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`ConfigError::Range`], [`ConfigError::Share`] or [`ConfigError::Settings`] for the first one at fault.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.name()?;
        if let Some(workers) = self.workers.filter(|workers| !(1..=1024).contains(workers)) {
            return Err(ConfigError::range("workers", "from 1 to 1024", &workers));
        }
        if let Some(digits) = &self.fetch
            && self.wanted().is_none()
        {
            return Err(ConfigError::range(
                "fetch",
                "a SHA-256 as 64 hexadecimal digits, as `egp inspect` shows it",
                digits,
            ));
        }
        let (least, most) = (1 + self.libraries.len(), 1 + Ready::MAX_OTHERS);
        if !(least..=most).contains(&self.max_libraries) {
            let expected = "at least the number of library files, and at most 64";
            return Err(ConfigError::range(
                "max_libraries",
                expected,
                &self.max_libraries,
            ));
        }
        if self.watch_ms != 0 && !(10..=3_600_000).contains(&self.watch_ms) {
            return Err(ConfigError::range(
                "watch_ms",
                "0 or in 10..=3600000",
                &self.watch_ms,
            ));
        }
        if !(1..=100_000).contains(&self.queue) {
            return Err(ConfigError::range("queue", "from 1 to 100000", &self.queue));
        }
        if self.drain_ms > 60_000 {
            return Err(ConfigError::range(
                "drain_ms",
                "at most 60000",
                &self.drain_ms,
            ));
        }
        if !(10..=3_600_000).contains(&self.load_ms) {
            return Err(ConfigError::range(
                "load_ms",
                "in 10..=3600000",
                &self.load_ms,
            ));
        }
        self.share()?;
        Ok(self.settings.validate()?)
    }
}

/// Reads an address for HTTP.
pub(crate) fn address<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<SocketAddr>, D::Error> {
    let text = String::deserialize(deserializer)?;
    let wrong = |_| {
        let expected = "`http` must be an IP address and a port, such as 127.0.0.1:9464, got";
        D::Error::custom(format!("{expected} {text:?}"))
    };
    text.parse().map(Some).map_err(wrong)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn only_the_library_is_required() {
        let config = ServiceConfig::from_toml("library = \"a.safetensors\"").unwrap();
        assert_eq!((config.replica.as_str(), config.queue), ("main", 256));
        assert!(
            ServiceConfig::from_toml("")
                .unwrap_err()
                .to_string()
                .contains("library")
        );
    }

    #[test]
    fn the_library_file_is_watched_if_the_configuration_says_how_often() {
        let mut config = ServiceConfig::new("a.safetensors");
        assert_eq!(config.watch(), None);
        config.watch_ms = 20;
        assert_eq!(config.watch(), Some(Duration::from_millis(20)));
    }

    #[test]
    fn mistakes_are_named() {
        for (text, name) in [
            ("libary = \"a\"", "libary"),
            ("library = \"a\"\nreplica = \"a/b\"", "`replica` must be"),
            ("library = \"a\"\nworkers = 0", "`workers` must be"),
            (
                "library = \"a\"\nmax_libraries = 0",
                "`max_libraries` must be",
            ),
            ("library = \"a\"\nwatch_ms = 1", "`watch_ms` must be"),
            ("library = \"a\"\ntraces_share = 2.0", "from 0 to 1, got 2"),
            (
                "library = \"a\"\ntraces_share = nan",
                "`traces_share` must be",
            ),
            ("library = \"a\"\nhttp = \"9464\"", "such as 127.0.0.1:9464"),
            ("library = \"a\"\n[settings]\nhorizn = 3", "horizn"),
            ("library = \"a\"\n[settings]\nmass = -1.0", "mass"),
        ] {
            let message = ServiceConfig::from_toml(text).unwrap_err().to_string();
            assert!(message.contains(name), "{text}: {message}");
        }
    }
}
