//! The libraries of a simulated replica: the product's table, with the time of the simulation.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use egp_core::library;
use egp_engine::EngineWorkspace;
use egp_service::{Handler, LibraryTable, TableFull, TableWorkspace};
use egp_wire::{Code, LibraryId, Ready, Reply, Request, Status, WireError};

use crate::ledger::NotedEngine;
use crate::mutant::Mutant;

/// Libraries that a replica may serve at a time: two or three.
pub(crate) fn limit(r: usize) -> usize {
    2 + r % 2
}

/// The content of a replica's library file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum File {
    /// A library of [`crate::Scene`], by its index.
    Library(usize),
    /// Bytes that are no library.
    Broken,
}

/// Why a library was not loaded.
pub(crate) enum LoadError {
    Broken,
    Full,
}

impl From<TableFull> for LoadError {
    fn from(_: TableFull) -> Self {
        Self::Full
    }
}

/// The time since a process started, on its own clock.
#[derive(Clone, Default)]
pub(crate) struct Uptime(Arc<AtomicU64>);

impl Uptime {
    pub(crate) fn set(&self, time: Duration) {
        let micros = u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        self.0.store(micros, Ordering::Relaxed);
    }

    pub(crate) fn get(&self) -> Duration {
        Duration::from_micros(self.0.load(Ordering::Relaxed))
    }
}

/// When each library of a process computed a reply last, as its engines noted.
#[derive(Clone, Default)]
pub(crate) struct Uses(Arc<Mutex<BTreeMap<LibraryId, Duration>>>);

impl Uses {
    pub(crate) fn note(&self, library: LibraryId, at: Duration) {
        let mut uses = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        uses.insert(library, at);
    }

    pub(crate) fn last(&self, library: &LibraryId) -> Option<Duration> {
        let uses = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        uses.get(library).copied()
    }
}

/// The libraries of one process.
#[derive(Clone)]
pub(crate) struct ProcessLibraries {
    pub(crate) table: Arc<LibraryTable<NotedEngine>>,
    pub(crate) uptime: Uptime,
    pub(crate) uses: Uses,
    pub(crate) mutant: Option<Mutant>,
    /// The libraries of the start.
    pub(crate) first: Vec<LibraryId>,
}

impl ProcessLibraries {
    /// Planted fault: computes a request with the newest library, and states the requested one in the reply.
    fn exchanged(
        &self,
        workspace: &mut TableWorkspace<EngineWorkspace>,
        mut request: Request,
        reply: &mut Vec<u8>,
    ) -> Option<Status> {
        let described = *self.table.ids().first()?;
        let stated = std::mem::replace(&mut request.library, described);
        let now = self.uptime.get();
        let status = self.table.step(workspace, &request.encode(), reply, now);
        let mut changed = Reply::decode(reply).ok()?;
        changed.library = stated;
        *reply = changed.encode();
        status.ok()
    }
}

impl Handler for ProcessLibraries {
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
        let stated = Request::decode(request);
        let described = self.table.ids().first().copied();
        let replaced = |request: &Request| {
            Some(request.library) != described && described != self.first.first().copied()
        };
        if let Some(request) = stated.ok().filter(replaced) {
            match self.mutant {
                Some(Mutant::ForgottenLibrary) => {
                    let detail = format!("planted: {} is gone", library::hex(&request.library));
                    return Err(WireError::retryable(Code::UnknownLibrary, 0, detail));
                }
                Some(Mutant::ExchangedLibrary) => {
                    if let Some(status) = self.exchanged(workspace, request, reply) {
                        return Ok(status);
                    }
                }
                _ => {}
            }
        }
        self.table
            .step(workspace, request, reply, self.uptime.get())
    }
}
