//! The life of a replica's process: start, kill, freeze, drain.

use std::time::Duration;

use egp_service::Replica;
use egp_wire::keys::{self, Name};

use crate::event::Event;
use crate::library::File;
use crate::link::token_delay;
use crate::mutant::Mutant;
use crate::oracle::Oracle;
use crate::replica::Stage;
use crate::router::Node;
use crate::scene::SimulationError;
use crate::world::{QUEUE, World};

/// Time from the withdrawal of a token to the end of a drain.
const DRAIN: Duration = Duration::from_millis(50);
/// Time from the end of a drain to the start of the next process, in which requests that wait are still answered.
const CLOSED: Duration = Duration::from_secs(1);

impl World<'_> {
    /// Notes since when each replica has been sound.
    pub(crate) fn judge_replicas(&mut self) {
        let now = self.now;
        for process in &mut self.replicas {
            process.sound_since = process.sound().then(|| process.sound_since.unwrap_or(now));
        }
    }

    /// Starts a replica that does not run, or that has drained.
    pub(crate) fn start(&mut self, r: usize) -> Result<(), SimulationError> {
        let process = &mut self.replicas[r];
        if process.machine.is_some() && process.declared() {
            return Ok(());
        }
        if process.frozen > 0 {
            // A frozen process has not ended, so that the next one starts only when it continues.
            process.deferred.push(Event::Start(r));
            return Ok(());
        }
        let missed = process
            .received
            .iter()
            .filter(|received| received.answers.get() != 1)
            .count();
        if missed > 0 {
            self.broken(
                Oracle::Answered,
                format!("r{r} drained and left {missed} queries"),
            );
        }
        let process = &mut self.replicas[r];
        if process.file == File::Broken {
            process.file = File::Library(0);
        }
        process.started = self.now + process.clock;
        let libraries = self.libraries(r);
        let queue = match self.config.mutant {
            Some(Mutant::UnboundedQueue) => 10 * QUEUE,
            _ => QUEUE,
        };
        let machine = Replica::new(name(r)?, libraries.clone(), 1 + r % 2, queue)?;
        let process = &mut self.replicas[r];
        process.libraries = Some(libraries);
        process.served.clear();
        (process.commanded, process.loading) = (false, false);
        process.machine = Some(match &self.keys {
            Some(keys) => machine.with_keys(keys.clone()),
            None => machine,
        });
        process.incarnation += 1;
        process.stage = Stage::Serving;
        process.received.clear();
        process.deferred.clear();
        self.note(&format!("r{r} starts"));
        self.note_served(r);
        self.close_home(r);
        self.connect(Node::Replica(r), 0);
        for v in 0..self.vehicles.len() {
            self.announce(v, r);
        }
        self.judge_replicas();
        Ok(())
    }

    pub(crate) fn announce(&mut self, v: usize, r: usize) {
        let delay = token_delay(&mut self.rng);
        if self.config.mutant != Some(Mutant::LostTokens) || self.now.is_zero() {
            self.agenda.add(self.now + delay, Event::Token(v, r, true));
        }
    }

    pub(crate) fn kill(&mut self, r: usize) {
        let process = &mut self.replicas[r];
        process.machine = None;
        process.stage = Stage::Closed;
        process.incarnation += 1;
        process.served.clear();
        process.received.clear();
        process.deferred.clear();
        process.frozen = 0;
        for v in 0..self.vehicles.len() {
            self.end_queries(v, r);
            let delay = token_delay(&mut self.rng);
            self.agenda.add(self.now + delay, Event::Token(v, r, false));
        }
        self.close_home(r);
    }

    /// Stops a process that runs, as SIGSTOP does, for a time.
    pub(crate) fn freeze(&mut self, r: usize, length: Duration) {
        let process = &mut self.replicas[r];
        if process.machine.is_none() {
            return;
        }
        process.frozen += 1;
        let thaw = Event::Thaw(r, process.incarnation);
        self.agenda.add(self.now.saturating_add(length), thaw);
        for v in 0..self.vehicles.len() {
            self.fall_silent(v, r);
        }
    }

    /// A frozen process continues: what waited in its sockets is processed.
    pub(crate) fn thaw(&mut self, r: usize, incarnation: u32) -> Result<(), SimulationError> {
        let process = &mut self.replicas[r];
        if process.incarnation != incarnation {
            return Ok(());
        }
        process.frozen -= 1;
        let continues = process.frozen == 0;
        self.note(&format!("Freeze({r}) ends"));
        if continues {
            self.resume(r)?;
        }
        self.judge_replicas();
        Ok(())
    }

    fn resume(&mut self, r: usize) -> Result<(), SimulationError> {
        let now = self.now;
        let process = &mut self.replicas[r];
        for received in &mut process.received {
            received.at = now;
        }
        for event in std::mem::take(&mut process.deferred) {
            match event {
                // What has waited is still answered.
                Event::Start(_) => self.agenda.add(now + CLOSED, event),
                event => self.happen(event)?,
            }
        }
        self.load_again(r);
        self.work(r);
        for v in 0..self.vehicles.len() {
            self.announce(v, r);
        }
        if self.replicas[r].stage == Stage::Terminated {
            self.replicas[r].stage = Stage::Serving;
            self.drain(r);
        }
        Ok(())
    }

    /// Drains a replica; one that is frozen begins when it continues, as a stopped process receives SIGTERM.
    pub(crate) fn drain(&mut self, r: usize) {
        let process = &mut self.replicas[r];
        if process.stage != Stage::Serving {
            return;
        }
        if process.frozen > 0 {
            process.stage = Stage::Terminated;
            return;
        }
        if let Some(machine) = &process.machine {
            machine.drain();
        }
        process.stage = Stage::Draining;
        let incarnation = process.incarnation;
        for v in 0..self.vehicles.len() {
            self.agenda.add(self.now, Event::Token(v, r, false));
        }
        self.agenda
            .add(self.now + DRAIN, Event::Undeclare(r, incarnation));
    }

    /// A draining replica receives no more queries; those that wait are still served.
    pub(crate) fn undeclare(&mut self, r: usize, incarnation: u32) {
        let drops = self.config.mutant == Some(Mutant::DroppingDrain);
        let process = &mut self.replicas[r];
        if process.incarnation != incarnation {
            return;
        }
        if process.frozen > 0 {
            process.deferred.push(Event::Undeclare(r, incarnation));
            return;
        }
        process.stage = Stage::Closed;
        process.served.clear();
        if let Some(machine) = &process.machine {
            machine.close();
        }
        if drops {
            process.machine = None;
        }
        self.agenda.add(self.now + CLOSED, Event::Start(r));
        self.judge_replicas();
    }
}

/// The name of a replica.
pub(crate) fn name(r: usize) -> Result<Name, keys::NameError> {
    format!("r{r}").parse()
}
