//! The libraries that one service serves, and their replacement while it runs.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use egp_core::{Settings, library};
use egp_engine::{Engine, EngineError, EngineWorkspace, read_library};
use egp_wire::{Code, Header, LibraryId, MessageLimits, Ready, Status, WireError};
use thiserror::Error;

use crate::config::ServiceConfig;
use crate::handler::Handler;
use crate::signature::{SignatureError, Signers};
use crate::sync::atomic::{AtomicU64, Ordering};
use crate::sync::{Arc, Mutex, PoisonError, RwLock};

/// A library that was asked for within this time is not removed, because a vehicle would lose its service.
const IN_USE: Duration = Duration::from_secs(60);

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

/// What a loading did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reloaded {
    /// Vehicles that start now get another library than before.
    Changed(LibraryId),
    /// The file holds the library that was served before.
    Same(LibraryId),
}

/// A library that is served.
struct Served {
    engine: Engine,
    description: Ready,
    /// When a request last asked for it, milliseconds after the start.
    asked: AtomicU64,
}

impl Served {
    fn id(&self) -> LibraryId {
        self.description.library
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
    limit: usize,
    started: Instant,
    /// At least one.
    served: RwLock<Arc<[Arc<Served>]>>,
    /// One reload at a time.
    loading: Mutex<()>,
}

/// Memory of one worker for each library that it computed a step with.
pub struct LibrariesWorkspace(Vec<(LibraryId, EngineWorkspace)>);

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
        let mut served = vec![Arc::new(Served::new(first))];
        for file in &config.libraries {
            let engine = load(file)?.with_cores_of(&served[0].engine);
            if served.iter().all(|one| one.id() != engine.library().id()) {
                served.push(Arc::new(Served::new(engine)));
            }
        }
        Ok(Self {
            file: config.library.clone(),
            settings: config.settings.clone(),
            signers,
            limit: config.max_libraries,
            started: Instant::now(),
            served: RwLock::new(served.into()),
            loading: Mutex::new(()),
        })
    }

    /// The file whose library `ready` describes.
    pub(crate) fn file(&self) -> &Path {
        &self.file
    }

    /// The hashes of all libraries, in the order of [`Ready`].
    pub fn ids(&self) -> Vec<LibraryId> {
        self.served().iter().map(|one| one.id()).collect()
    }

    /// Loads and checks the library file again, and lets `ready` describe its library from now on. Libraries from before are
    /// still served to requests that state them; if there are more than the configuration allows, the one that was not
    /// asked for the longest time is removed.
    ///
    /// # Errors
    /// [`ReloadError`] if the file cannot be used or no library can be removed; nothing changes then.
    pub fn reload(&self) -> Result<Reloaded, ReloadError> {
        let _one = self.loading.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.served();
        let bytes = read(&self.file, self.signers.as_ref())?;
        // A library that is served was checked when it was loaded.
        let id = library::hash(&bytes);
        let known = before.iter().position(|one| one.id() == id);
        let mut after: Vec<_> = before.to_vec();
        match known {
            Some(0) => return Ok(Reloaded::Same(id)),
            Some(index) => after[..=index].rotate_right(1),
            None => {
                let engine = Engine::from_bytes(&self.file, &bytes, self.settings.clone())?;
                let engine = match before.first() {
                    Some(first) => engine.with_cores_of(&first.engine),
                    None => engine,
                };
                after.insert(0, Arc::new(Served::new(engine)));
                if after.len() > self.limit {
                    after.remove(self.removable(&after)?);
                }
            }
        }
        *self.served.write().unwrap_or_else(PoisonError::into_inner) = after.into();
        Ok(Reloaded::Changed(id))
    }

    /// The index of the library that was not asked for the longest time; the new one at index 0 is excepted.
    fn removable(&self, all: &[Arc<Served>]) -> Result<usize, ReloadError> {
        let now = self.now();
        let in_use =
            |asked: u64| asked > 0 && Duration::from_millis(now.saturating_sub(asked)) < IN_USE;
        let ages = all.iter().enumerate().skip(1);
        ages.map(|(index, one)| (one.asked.load(Ordering::Relaxed), index))
            .min()
            .filter(|(asked, _)| !in_use(*asked))
            .map(|(_, index)| index)
            .ok_or(ReloadError::Full { limit: self.limit })
    }

    /// Milliseconds since the start, at least 1.
    fn now(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX - 1) + 1
    }

    fn served(&self) -> Arc<[Arc<Served>]> {
        let served = self.served.read();
        served.unwrap_or_else(PoisonError::into_inner).clone()
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

impl Served {
    fn new(engine: Engine) -> Self {
        Self {
            description: engine.describe(),
            engine,
            asked: AtomicU64::new(0),
        }
    }
}

impl Handler for Libraries {
    type Workspace = LibrariesWorkspace;

    fn describe(&self) -> Ready {
        let served = self.served();
        let (first, others) = (&served[0], &served[1..]);
        Ready {
            others: others.iter().map(|one| one.id()).collect(),
            ..first.description.clone()
        }
    }

    fn workspace(&self) -> Result<LibrariesWorkspace, WireError> {
        let served = self.served();
        let memory = served
            .iter()
            .map(|one| Ok((one.id(), one.engine.workspace()?)));
        Ok(LibrariesWorkspace(
            memory.collect::<Result<_, WireError>>()?,
        ))
    }

    fn step(
        &self,
        LibrariesWorkspace(memory): &mut LibrariesWorkspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError> {
        let asked = Header::decode(request, &MessageLimits::default())?.library;
        let served = self.served();
        let Some(one) = served.iter().find(|one| one.id() == asked) else {
            return Err(self.unknown(&asked));
        };
        one.asked.store(self.now(), Ordering::Relaxed);
        if memory.len() > served.len() {
            memory.retain(|(id, _)| served.iter().any(|one| one.id() == *id));
        }
        let known = memory.iter().position(|(id, _)| *id == asked);
        let index = known.unwrap_or(memory.len());
        if known.is_none() {
            memory.push((asked, one.engine.workspace()?));
        }
        one.engine.step(&mut memory[index].1, request, reply)
    }
}

impl Libraries {
    fn unknown(&self, asked: &LibraryId) -> WireError {
        let ids: Vec<_> = self.ids().iter().map(|id| library::hex(id)).collect();
        let detail = format!(
            "this replica serves library {}, the request states {}; ask `ready` what a replica serves",
            ids.join(" and "),
            library::hex(asked)
        );
        // Another replica may serve it.
        WireError::retryable(Code::UnknownLibrary, 0, detail)
    }
}
