//! The libraries of one service, loaded from files at the start and again while it runs.

use std::path::{Path, PathBuf};
use std::time::Instant;

use egp_core::{Settings, library};
use egp_engine::{Engine, EngineError, EngineWorkspace, read_library};
use egp_wire::{LibraryId, Ready, Status, WireError};
use thiserror::Error;

use crate::config::ServiceConfig;
use crate::handler::{Handler, LibraryContent};
use crate::library_table::{LibraryTable, Reloaded, TableFull, TableWorkspace};
use crate::signature::{Signature, SignatureError, Signers, signature_beside};
use crate::sync::{Arc, Mutex, PoisonError};

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
    /// The loading panicked.
    #[error("the loading failed by a defect of the service; please report it")]
    Defect,
    /// The thread that loads libraries has ended.
    #[error("the thread that loads libraries has ended; restart the service")]
    Ended,
}

impl ReloadError {
    /// Whether another attempt may succeed with the same file.
    pub(crate) fn may_heal(&self) -> bool {
        match self {
            Self::Engine(error) => matches!(error, EngineError::Read { .. }),
            Self::Signature(_) | Self::Full { .. } | Self::Defect => true,
            Self::NoFile | Self::Ended => false,
        }
    }
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
    /// The file of the public keys of those who may sign libraries, which each reload reads again.
    keys: Option<PathBuf>,
    started: Instant,
    table: LibraryTable<Loaded>,
    /// One reload at a time.
    loading: Mutex<()>,
}

impl Libraries {
    /// Loads the libraries of a configuration.
    ///
    /// # Errors
    /// [`ReloadError`]; the message names the file.
    pub fn load(config: &ServiceConfig) -> Result<Self, ReloadError> {
        let signers = signers(config.library_keys.as_deref())?;
        let load = |file: &Path| Loaded::from_file(file, &config.settings, signers.as_ref());
        let first = load(&config.library)?;
        let first = Loaded {
            engine: first.engine.with_cores(config.workers())?,
            ..first
        };
        let further = config.libraries.iter();
        let further = further.map(|file| Ok(load(file)?.with_cores_of(&first)));
        let further = further.collect::<Result<Vec<_>, ReloadError>>()?;
        Ok(Self {
            file: config.library.clone(),
            settings: config.settings.clone(),
            keys: config.library_keys.clone(),
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

    /// Loads and checks the file of public keys and the library file again, and lets `ready` describe its library from now on.
    /// The signature beside the file takes the place of the one that was offered with this library before. Libraries from before are
    /// still served to requests that state them; if there are more than the configuration allows, the one that was neither
    /// asked for nor described for the longest time is removed.
    ///
    /// # Errors
    /// [`ReloadError`] if the file cannot be used or no library can be removed; nothing changes then.
    pub fn reload(&self) -> Result<Reloaded, ReloadError> {
        let _one = self.loading.lock().unwrap_or_else(PoisonError::into_inner);
        let signers = signers(self.keys.as_deref())?;
        let content = read(&self.file, signers.as_ref())?;
        let (id, signature) = (library::hash(&content.bytes), content.signature);
        // A library that is served was checked when it was loaded, and is not made again.
        let load = |described: &Loaded| -> Result<Loaded, ReloadError> {
            let loaded = Loaded::new(&self.file, content, &self.settings)?;
            Ok(loaded.with_cores_of(described))
        };
        let reloaded = self.table.replace(id, self.started.elapsed(), load)?;
        // The signature of a library that was served before may be new.
        self.table.first(|described| described.sign(signature));
        Ok(reloaded)
    }

    /// Whether a reload finds a place for a library that is not served.
    pub(crate) fn has_room(&self) -> bool {
        self.table.has_room(self.started.elapsed())
    }
}

/// An engine, and the file of its library and the signature beside it for others who fetch them.
struct Loaded {
    engine: Engine,
    bytes: Arc<[u8]>,
    signature: Mutex<Option<Signature>>,
}

impl Loaded {
    /// Loads a file, whose signature is checked if there are signers.
    fn from_file(
        file: &Path,
        settings: &Settings,
        signers: Option<&Signers>,
    ) -> Result<Self, ReloadError> {
        Self::new(file, read(file, signers)?, settings)
    }

    fn new(file: &Path, content: LibraryContent, settings: &Settings) -> Result<Self, ReloadError> {
        Ok(Self {
            engine: Engine::from_bytes(file, &content.bytes, settings.clone())?,
            bytes: content.bytes,
            signature: Mutex::new(content.signature),
        })
    }

    /// Offers the library with this signature from now on.
    fn sign(&self, signature: Option<Signature>) {
        *self
            .signature
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = signature;
    }

    fn with_cores_of(mut self, other: &Self) -> Self {
        self.engine = self.engine.with_cores_of(&other.engine);
        self
    }
}

/// Those who may sign libraries, if there is a file of their public keys.
fn signers(keys: Option<&Path>) -> Result<Option<Signers>, ReloadError> {
    Ok(keys.map(Signers::load).transpose()?)
}

/// The content of a library file, whose signature is checked if there are signers.
fn read(file: &Path, signers: Option<&Signers>) -> Result<LibraryContent, ReloadError> {
    let bytes = read_library(file).map_err(|source| EngineError::Read {
        path: file.display().to_string(),
        source,
    })?;
    let signature = match signers {
        Some(signers) => Some(signers.check(file, &bytes)?),
        // Who fetches the library may demand a signature although this service does not.
        None => signature_beside(file).ok(),
    };
    Ok(LibraryContent {
        bytes: Arc::from(bytes),
        signature,
    })
}

impl Handler for Loaded {
    type Workspace = EngineWorkspace;

    fn describe(&self) -> Ready {
        self.engine.describe()
    }

    fn workspace(&self) -> Result<EngineWorkspace, WireError> {
        self.engine.workspace()
    }

    fn step(
        &self,
        workspace: &mut EngineWorkspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError> {
        self.engine.step(workspace, request, reply)
    }

    fn content(&self, _library: &LibraryId) -> Option<LibraryContent> {
        let signature = self.signature.lock();
        Some(LibraryContent {
            bytes: self.bytes.clone(),
            signature: *signature.unwrap_or_else(PoisonError::into_inner),
        })
    }
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

    fn content(&self, library: &LibraryId) -> Option<LibraryContent> {
        self.table.content(library)
    }
}
