//! A replica loads its library file again while it serves.

use std::sync::Arc;
use std::time::Duration;

use egp_service::LibraryTable;
use egp_wire::{Code, LibraryId, WireError};
use rand::RngExt;

use crate::event::{Event, Message};
use crate::ledger::NotedEngine;
use crate::library::{File, LoadError, ProcessLibraries, Uptime, Uses, limit};
use crate::oracle::Oracle;
use crate::world::World;

/// The time in which a library is read and checked, µs; one that is served already is recognised by its hash.
const LOADING: std::ops::Range<u64> = 100_000..500_000;
const RECOGNISED: std::ops::Range<u64> = 1000..5000;
/// A library that computed a reply within this time stays served.
const KEPT: Duration = Duration::from_secs(60);

impl World<'_> {
    /// The libraries of a new process: that of its file, and the second one if vehicles use it.
    pub(crate) fn libraries(&mut self, r: usize) -> ProcessLibraries {
        let (uptime, uses) = (Uptime::default(), Uses::default());
        let noted = |index: usize| NotedEngine {
            engine: self.scene.engines[index].clone(),
            ledger: self.ledger.clone(),
            uptime: uptime.clone(),
            uses: uses.clone(),
        };
        // A process with a broken file would not start; whoever starts it puts the usual file back first.
        let file = match self.replicas[r].file {
            File::Library(index) => index,
            File::Broken => 0,
        };
        let further = self.config.two_libraries.then(|| [noted(0), noted(1)]);
        let further = further.into_iter().flatten();
        let table = LibraryTable::new(noted(file), further, limit(r));
        let first = table.ids();
        ProcessLibraries {
            table: Arc::new(table),
            uptime,
            uses,
            mutant: self.config.mutant,
            first,
        }
    }

    /// Replaces a replica's file and commands it to load the file, as SIGHUP does.
    pub(crate) fn replace_file(&mut self, r: usize, file: File) {
        self.replicas[r].file = file;
        self.replicas[r].commanded = true;
        self.load_again(r);
    }

    /// Begins a loading that was commanded, unless another one is under way or the process stands still.
    pub(crate) fn load_again(&mut self, r: usize) {
        let process = &mut self.replicas[r];
        let Some(libraries) = process
            .libraries
            .as_ref()
            .filter(|_| process.machine.is_some())
        else {
            process.commanded = false;
            return;
        };
        if !process.commanded || process.loading || process.frozen > 0 {
            return;
        }
        (process.commanded, process.loading) = (false, true);
        let (file, incarnation) = (process.file, process.incarnation);
        let known = match file {
            File::Library(index) => {
                let id = self.scene.engines[index].library().id();
                libraries.table.ids().contains(&id)
            }
            File::Broken => true,
        };
        let micros = self
            .rng
            .random_range(if known { RECOGNISED } else { LOADING });
        let due = self.now + Duration::from_micros(micros);
        self.agenda.add(due, Event::Loaded(r, incarnation, file));
    }

    /// A library was read and checked.
    pub(crate) fn loaded(&mut self, r: usize, incarnation: u32, file: File) {
        let process = &mut self.replicas[r];
        if process.incarnation != incarnation {
            return;
        }
        if process.frozen > 0 {
            process.deferred.push(Event::Loaded(r, incarnation, file));
            return;
        }
        process.loading = false;
        let Some(libraries) = process.libraries.clone() else {
            return;
        };
        libraries
            .uptime
            .set((self.now + process.clock).saturating_sub(process.started));
        let outcome = match file {
            File::Broken => Err(LoadError::Broken),
            File::Library(index) => {
                let noted = NotedEngine {
                    engine: self.scene.engines[index].clone(),
                    ledger: self.ledger.clone(),
                    uptime: libraries.uptime.clone(),
                    uses: libraries.uses.clone(),
                };
                let id = noted.engine.library().id();
                let load = |_: &NotedEngine| Ok::<_, LoadError>(noted);
                libraries.table.replace(id, libraries.uptime.get(), load)
            }
        };
        let text = match outcome {
            Ok(outcome) => format!("{outcome:?}").chars().take(7).collect(),
            Err(LoadError::Broken) => "no library".to_owned(),
            Err(LoadError::Full) => "no room".to_owned(),
        };
        let count = libraries.table.ids().len();
        self.note(&format!(
            "r{r} has loaded {file:?}: {text}, serves {count} libraries"
        ));
        self.note_served(r);
        self.work(r);
        self.load_again(r);
    }

    /// Notes since when each library has been served.
    pub(crate) fn note_served(&mut self, r: usize) {
        let now = self.now;
        let process = &mut self.replicas[r];
        let ids = process
            .libraries
            .as_ref()
            .map_or_else(Vec::new, |libraries| libraries.table.ids());
        process.served.retain(|id, _| ids.contains(id));
        for id in ids {
            process.served.entry(id).or_insert(now);
        }
    }

    /// Checks that a replica does not report a library as unknown that it must still serve.
    pub(crate) fn judge_library(&mut self, v: usize, r: usize, message: &Message) {
        let Message::Error(error) = message else {
            return;
        };
        let unknown =
            WireError::decode(error).is_ok_and(|error| error.code == Code::UnknownLibrary);
        let library = self.vehicles[v].driver.served().library;
        if unknown && self.must_serve(r, &library) {
            self.broken(
                Oracle::Library,
                format!("r{r} no longer serves the library of car-{v}, which is in use"),
            );
        }
    }

    /// Whether a replica must serve a library: one of its replies was computed with it within the last minute.
    fn must_serve(&self, r: usize, library: &LibraryId) -> bool {
        let used = |libraries: &ProcessLibraries| {
            let last = libraries.uses.last(library)?;
            Some(libraries.uptime.get().saturating_sub(last) < KEPT)
        };
        self.replicas[r].libraries.as_ref().and_then(used) == Some(true)
    }
}
