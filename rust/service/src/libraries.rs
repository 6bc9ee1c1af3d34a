//! The libraries of one service, loaded from files at the start and again while it runs.

use std::path::{Path, PathBuf};
use std::time::Instant;

use egp_core::{Settings, library};
use egp_engine::{Engine, EngineError, EngineWorkspace, read_library};
use egp_wire::{LibraryId, Ready, Status, WireError};
use thiserror::Error;

use crate::config::ServiceConfig;
use crate::handler::Handler;
use crate::library_table::{LibraryTable, Reloaded, TableFull, TableWorkspace};
use crate::signature::{SignatureError, Signers};
use crate::sync::{Mutex, PoisonError};

/// Why a library was not loaded. What was served before is still served.
#[derive(Debug, Error)]
pub enum ReloadError {
    /// The library or the settings cannot be used.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The library is not signed as the configuration demands.
    #[error(transparent)]
    Signature(#[from] SignatureError),
    /// No library can be removed for the new one.
    #[error(
        "{limit} libraries are served, and vehicles asked for each of them within the last minute; restart the vehicles \
         that use old ones, or raise max_libraries"
    )]
    Full {
        /// The largest number of libraries.
        limit: usize,
    },
    /// The service has no library file: it was started with a handler of its own.
    #[error("this service was not started from a library file")]
    NoFile,
}

impl From<TableFull> for ReloadError {
    fn from(TableFull { limit }: TableFull) -> Self {
        Self::Full { limit }
    }
}

/// Several libraries, of which each request states one by its hash. The first is the one that `ready` describes.
///
/// A new library is loaded and checked beside those that are served, and takes effect with the next request; a step that
/// runs ends with the library that it began with.
pub struct Libraries {
    file: PathBuf,
    settings: Settings,
    signers: Option<Signers>,
    started: Instant,
    table: LibraryTable<Engine>,
    /// One reload at a time.
    loading: Mutex<()>,
}

impl Libraries {
    /// Loads the libraries of a configuration.
    ///
    /// # Errors
    /// [`ReloadError`]; the message names the file.
    pub fn load(config: &ServiceConfig) -> Result<Self, ReloadError> {
        let signers = config
            .library_keys
            .as_deref()
            .map(Signers::load)
            .transpose()?;
        let load = |file: &Path| load(file, &config.settings, signers.as_ref());
        let first = load(&config.library)?.with_cores(config.workers())?;
        let further = config.libraries.iter();
        let further = further.map(|file| Ok(load(file)?.with_cores_of(&first)));
        let further = further.collect::<Result<Vec<_>, ReloadError>>()?;
        Ok(Self {
            file: config.library.clone(),
            settings: config.settings.clone(),
            signers,
            started: Instant::now(),
            table: LibraryTable::new(first, further, config.max_libraries),
            loading: Mutex::new(()),
        })
    }

    /// The file whose library `ready` describes.
    pub(crate) fn file(&self) -> &Path {
        &self.file
    }

    /// The hashes of all libraries, in the order of [`Ready`].
    pub fn ids(&self) -> Vec<LibraryId> {
        self.table.ids()
    }

    /// Loads and checks the library file again, and lets `ready` describe its library from now on. Libraries from before are
    /// still served to requests that state them; if there are more than the configuration allows, the one that was not
    /// asked for the longest time is removed.
    ///
    /// # Errors
    /// [`ReloadError`] if the file cannot be used or no library can be removed; nothing changes then.
    pub fn reload(&self) -> Result<Reloaded, ReloadError> {
        let _one = self.loading.lock().unwrap_or_else(PoisonError::into_inner);
        let bytes = read(&self.file, self.signers.as_ref())?;
        // A library that is served was checked when it was loaded, and is not made again.
        let load = |described: &Engine| {
            let engine = Engine::from_bytes(&self.file, &bytes, self.settings.clone())?;
            Ok(engine.with_cores_of(described))
        };
        let id = library::hash(&bytes);
        self.table.replace(id, self.started.elapsed(), load)
    }
}

/// An engine with the library of a file, whose signature is checked if there are signers.
fn load(
    file: &Path,
    settings: &Settings,
    signers: Option<&Signers>,
) -> Result<Engine, ReloadError> {
    let bytes = read(file, signers)?;
    Ok(Engine::from_bytes(file, &bytes, settings.clone())?)
}

/// The bytes of a library file, whose signature is checked if there are signers.
fn read(file: &Path, signers: Option<&Signers>) -> Result<Vec<u8>, ReloadError> {
    let bytes = read_library(file).map_err(|source| EngineError::Read {
        path: file.display().to_string(),
        source,
    })?;
    if let Some(signers) = signers {
        signers.check(file, &bytes)?;
    }
    Ok(bytes)
}

impl Handler for Libraries {
    type Workspace = TableWorkspace<EngineWorkspace>;

    fn describe(&self) -> Ready {
        self.table.describe()
    }

    fn workspace(&self) -> Result<Self::Workspace, WireError> {
        self.table.workspace()
    }

    fn step(
        &self,
        workspace: &mut Self::Workspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError> {
        let now = self.started.elapsed();
        self.table.step(workspace, request, reply, now)
    }
}
