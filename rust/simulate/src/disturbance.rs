//! What faults do to replicas, links and clocks.

use std::rc::Rc;
use std::time::Duration;

use egp_service::Replica;
use egp_wire::keys::{self, Name};
use egp_wire::{MessageLimits, Request};
use rand::RngExt;

use crate::event::Event;
use crate::fault::Fault;
use crate::ledger::NotedEngine;
use crate::link::{lease, token_delay};
use crate::mutant::Mutant;
use crate::oracle::Oracle;
use crate::replica::{Exchange, Stage};
use crate::scene::SimulationError;
use crate::world::{QUEUE, World};

/// Time from the start of a process to its announcement, and from the withdrawal to the end of a drain.
const START: Duration = Duration::from_millis(300);
const DRAIN: Duration = Duration::from_millis(50);
/// Time between two requests of a flood, and the number of names that it uses.
const FLOOD: Duration = Duration::from_millis(1);
const NAMES: u32 = 64;
/// The budget of a patient request of a flood, µs.
const PATIENT: u32 = 10_000_000;

impl World<'_> {
    pub(crate) fn begin(&mut self, fault: Fault) -> Result<(), SimulationError> {
        self.run.faults += 1;
        self.note(&format!("{fault:?} begins"));
        match fault {
            Fault::Kill(r) => self.kill(r),
            Fault::Restart(r) => {
                self.kill(r);
                self.agenda.add(self.now + START, Event::Start(r));
            }
            Fault::Reload(r) => {
                self.kill(r);
                self.replicas[r].other_library = true;
                self.start(r)?;
            }
            Fault::Freeze(r) => {
                self.replicas[r].frozen += 1;
                for v in 0..self.vehicles.len() {
                    self.fall_silent(v, r);
                }
            }
            Fault::Slow(r) => self.replicas[r].slow += 1,
            Fault::Hostile(r) => self.replicas[r].hostile += 1,
            Fault::Disorder(r) => self.replicas[r].disorder += 1,
            Fault::Flood(r) => {
                self.replicas[r].flood += 1;
                self.agenda.add(self.now, Event::Flood(r, 0));
            }
            Fault::Partition(v, r) => {
                self.links[v][r].cut += 1;
                self.fall_silent(v, r);
            }
            Fault::HalfOpen(v, r) => {
                self.links[v][r].half += 1;
                self.fall_silent(v, r);
            }
            Fault::VehicleClock(v) => {
                let jump = self.jump();
                self.vehicles[v].clock += jump;
            }
            Fault::ReplicaClock(r) => {
                let jump = self.jump();
                self.replicas[r].clock += jump;
            }
            Fault::Drain(r) => self.drain(r),
        }
        self.judge_replicas();
        Ok(())
    }

    pub(crate) fn finish(&mut self, fault: Fault) -> Result<(), SimulationError> {
        self.note(&format!("{fault:?} ends"));
        match fault {
            Fault::Kill(r) => self.start(r)?,
            Fault::Reload(r) => {
                self.kill(r);
                self.replicas[r].other_library = false;
                self.start(r)?;
            }
            Fault::Freeze(r) => self.thaw(r),
            Fault::Slow(r) => self.replicas[r].slow -= 1,
            Fault::Hostile(r) => self.replicas[r].hostile -= 1,
            Fault::Disorder(r) => self.replicas[r].disorder -= 1,
            Fault::Flood(r) => self.replicas[r].flood -= 1,
            Fault::Partition(v, r) => {
                self.links[v][r].cut -= 1;
                self.heal(v, r);
            }
            Fault::HalfOpen(v, r) => {
                self.links[v][r].half -= 1;
                self.heal(v, r);
            }
            Fault::Restart(_)
            | Fault::VehicleClock(_)
            | Fault::ReplicaClock(_)
            | Fault::Drain(_) => {}
        }
        self.judge_replicas();
        Ok(())
    }

    fn jump(&mut self) -> Duration {
        Duration::from_micros(self.rng.random_range(1000..500_000))
    }

    /// Notes since when each replica has been sound.
    fn judge_replicas(&mut self) {
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
        let engine = if process.other_library {
            &self.scene.other
        } else {
            &self.scene.engine
        };
        let handler = NotedEngine {
            engine: engine.clone(),
            ledger: self.ledger.clone(),
        };
        let queue = match self.config.mutant {
            Some(Mutant::UnboundedQueue) => 10 * QUEUE,
            _ => QUEUE,
        };
        let machine = Replica::new(name(r)?, handler, 1 + r % 2, queue)?;
        process.machine = Some(match &self.keys {
            Some(keys) => machine.with_keys(keys.clone()),
            None => machine,
        });
        process.incarnation += 1;
        process.stage = Stage::Serving;
        process.received.clear();
        process.waiting.clear();
        process.ended.clear();
        self.note(&format!("r{r} starts"));
        for v in 0..self.vehicles.len() {
            self.announce(v, r);
        }
        self.judge_replicas();
        Ok(())
    }

    fn announce(&mut self, v: usize, r: usize) {
        let delay = token_delay(&mut self.rng);
        if self.config.mutant != Some(Mutant::LostTokens) || self.now.is_zero() {
            self.agenda.add(self.now + delay, Event::Token(v, r, true));
        }
    }

    fn kill(&mut self, r: usize) {
        let process = &mut self.replicas[r];
        process.machine = None;
        process.stage = Stage::Closed;
        process.incarnation += 1;
        process.received.clear();
        process.waiting.clear();
        process.ended.clear();
        for v in 0..self.vehicles.len() {
            self.end_queries(v, r);
            let delay = token_delay(&mut self.rng);
            self.agenda.add(self.now + delay, Event::Token(v, r, false));
        }
    }

    /// A frozen process continues: what waited in its sockets is processed.
    fn thaw(&mut self, r: usize) {
        let process = &mut self.replicas[r];
        process.frozen -= 1;
        if process.frozen > 0 {
            return;
        }
        let (now, incarnation) = (self.now, process.incarnation);
        for received in &mut process.received {
            received.at = now;
        }
        let waiting = std::mem::take(&mut process.waiting);
        for worker in std::mem::take(&mut process.ended) {
            self.step_ends(r, incarnation, worker);
        }
        for exchange in waiting {
            self.arrive(r, incarnation, exchange);
        }
        self.work(r);
        for v in 0..self.vehicles.len() {
            self.announce(v, r);
        }
        if self.replicas[r].stage == Stage::Terminated {
            self.replicas[r].stage = Stage::Serving;
            self.drain(r);
        }
    }

    /// Drains a replica; one that is frozen begins when it continues, as a stopped process receives SIGTERM.
    fn drain(&mut self, r: usize) {
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
        process.stage = Stage::Closed;
        if let Some(machine) = &process.machine {
            machine.close();
        }
        if drops {
            process.machine = None;
        }
        self.agenda
            .add(self.now + Duration::from_secs(1), Event::Start(r));
        self.judge_replicas();
    }

    /// A link on which nothing arrives is closed when its lease has passed.
    fn fall_silent(&mut self, v: usize, r: usize) {
        let lease = lease(&mut self.rng);
        self.agenda.add(self.now + lease, Event::Token(v, r, false));
    }

    fn heal(&mut self, v: usize, r: usize) {
        self.links[v][r].since = self.now;
        self.announce(v, r);
    }

    /// A vehicle sees a token appear or go, if that is still so and it did not see it before.
    pub(crate) fn token(&mut self, v: usize, r: usize, alive: bool) {
        let process = &self.replicas[r];
        let link = self.links[v][r];
        let silent = process.frozen > 0 || !link.asks_pass() || !link.answers_pass();
        let announced = matches!(process.stage, Stage::Serving | Stage::Terminated);
        let there = process.machine.is_some() && announced && !silent;
        let seen = alive.then_some(process.incarnation);
        if there != alive || link.seen == seen {
            return;
        }
        self.links[v][r].seen = seen;
        let Ok(replica) = name(r) else {
            return;
        };
        let now = self.time_of(v);
        self.note(&format!(
            "car-{v} sees r{r} {}",
            if alive { "appear" } else { "go" }
        ));
        if alive {
            self.vehicles[v].driver.replica_appeared(now, replica);
        } else {
            self.end_queries(v, r);
            self.vehicles[v].driver.replica_gone(now, &replica);
        }
        self.act(v);
    }

    /// One request of a flood, and the next.
    pub(crate) fn flood(&mut self, r: usize, count: u32) {
        let process = &self.replicas[r];
        if process.flood == 0 {
            return;
        }
        let incarnation = process.incarnation;
        self.agenda
            .add(self.now + FLOOD, Event::Flood(r, count + 1));
        let names = name(r).and_then(|replica| {
            let (fleet, sender) = ("strangers".parse()?, format!("s{}", count % NAMES).parse()?);
            Ok(keys::step(&replica, &fleet, &sender))
        });
        let request = Request::decode(&self.last_request, &MessageLimits::default());
        let (Ok(key), Ok(mut request)) = (names, request) else {
            return;
        };
        if self.rng.random::<bool>() {
            request.budget_us = PATIENT;
        }
        let exchange = Exchange {
            key,
            payload: request.encode(),
            attachment: Vec::new(),
            asker: None,
            outbox: self.outbox.clone(),
            answers: Rc::default(),
        };
        self.arrive(r, incarnation, exchange);
    }
}

fn name(r: usize) -> Result<Name, keys::NameError> {
    format!("r{r}").parse()
}
