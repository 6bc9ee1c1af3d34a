//! What faults do to replicas, links and clocks.

use std::rc::Rc;
use std::time::Duration;

use egp_wire::Request;
use egp_wire::keys;
use rand::RngExt;

use crate::event::Event;
use crate::fault::Fault;
use crate::library::File;
use crate::lifecycle::name;
use crate::link::{Link, lease};
use crate::replica::{Exchange, Stage};
use crate::scene::SimulationError;
use crate::world::World;

/// Time from the end of a process to the start of the next one in a restart.
const START: Duration = Duration::from_millis(300);
/// Time between two requests of a flood, and the number of names that it uses.
const FLOOD: Duration = Duration::from_millis(1);
const NAMES: u32 = 64;
/// The longest time for which the program of a vehicle is held up, µs: as long as a plan may bridge, and as much again.
const HELD_UP: u64 = 1_000_000;
/// The budget of a patient request of a flood, µs.
const PATIENT: u32 = 10_000_000;

impl World<'_> {
    pub(crate) fn begin(&mut self, fault: Fault, length: Duration) -> Result<(), SimulationError> {
        self.run.faults += 1;
        self.note(&format!("{fault:?} begins"));
        match fault {
            Fault::Kill(r) => self.kill(r),
            Fault::Restart(r) => {
                self.kill(r);
                self.agenda.add(self.now + START, Event::Start(r));
            }
            Fault::Reload(r) => {
                let file = self.other_file();
                self.replace_file(r, file);
            }
            Fault::OtherLibrary(r) => {
                self.kill(r);
                self.replicas[r].file = File::Library(1);
                self.start(r)?;
            }
            Fault::RouterKill(k) => self.kill_router(k),
            Fault::RouterRestart(k) => {
                self.kill_router(k);
                self.agenda.add(self.now + START, Event::StartRouter(k));
            }
            Fault::RouterFreeze(k) => self.freeze_router(k),
            Fault::Freeze(r) => self.freeze(r, length),
            Fault::Slow(r) => self.replicas[r].slow += 1,
            Fault::Hostile(r) => self.replicas[r].hostile += 1,
            Fault::Disorder(r) => self.replicas[r].disorder += 1,
            Fault::Flood(r) => {
                self.replicas[r].flood += 1;
                self.agenda.add(self.now, Event::Flood(r, 0));
            }
            Fault::Partition(v, r) => self.disturb_link(v, r, |link| link.cut += 1),
            Fault::HalfOpen(v, r) => self.disturb_link(v, r, |link| link.half += 1),
            Fault::VehicleClock(v) => {
                let jump = Duration::from_micros(self.rng.random_range(1000..HELD_UP));
                self.vehicles[v].clock += jump;
            }
            Fault::ReplicaClock(r) => {
                let jump = self.jump();
                self.replicas[r].clock += jump;
            }
            Fault::Drain(r) => self.drain(r),
        }
        // The end of a freeze is that of the process which was frozen.
        if !matches!(fault, Fault::Freeze(_)) {
            let end = self.now.saturating_add(length);
            self.agenda.add(end, Event::Finish(fault));
        }
        self.judge_replicas();
        Ok(())
    }

    pub(crate) fn finish(&mut self, fault: Fault) -> Result<(), SimulationError> {
        self.note(&format!("{fault:?} ends"));
        match fault {
            Fault::Kill(r) => self.start(r)?,
            Fault::Reload(r) => self.replace_file(r, File::Library(0)),
            Fault::OtherLibrary(r) => {
                self.kill(r);
                self.replicas[r].file = File::Library(0);
                self.start(r)?;
            }
            Fault::RouterKill(k) => self.start_router(k),
            Fault::RouterFreeze(k) => self.thaw_router(k),
            Fault::Slow(r) => self.replicas[r].slow -= 1,
            Fault::Hostile(r) => self.replicas[r].hostile -= 1,
            Fault::Disorder(r) => self.replicas[r].disorder -= 1,
            Fault::Flood(r) => self.replicas[r].flood -= 1,
            Fault::Partition(v, r) => self.heal(v, r, |link| link.cut -= 1),
            Fault::HalfOpen(v, r) => self.heal(v, r, |link| link.half -= 1),
            Fault::Restart(_)
            | Fault::Freeze(_)
            | Fault::RouterRestart(_)
            | Fault::VehicleClock(_)
            | Fault::ReplicaClock(_)
            | Fault::Drain(_) => {}
        }
        self.judge_replicas();
        Ok(())
    }

    /// The replicas whose link to a vehicle is cut with that to replica `r`: with routers it is the vehicle's own link.
    fn behind(&self, r: usize) -> std::ops::Range<usize> {
        if self.routers.direct() {
            r..r + 1
        } else {
            0..self.replicas.len()
        }
    }

    fn jump(&mut self) -> Duration {
        Duration::from_micros(self.rng.random_range(1000..500_000))
    }

    /// A link on which nothing arrives is closed when its lease has passed.
    pub(crate) fn fall_silent(&mut self, v: usize, r: usize) {
        let lease = lease(&mut self.rng);
        self.agenda.add(self.now + lease, Event::Token(v, r, false));
    }

    /// Begins a fault of the link between a vehicle and a replica.
    fn disturb_link(&mut self, v: usize, r: usize, begin: impl Fn(&mut Link)) {
        for r in self.behind(r) {
            begin(&mut self.links[v][r]);
            self.fall_silent(v, r);
        }
    }

    /// Ends a fault of the link between a vehicle and a replica.
    fn heal(&mut self, v: usize, r: usize, end: impl Fn(&mut Link)) {
        for r in self.behind(r) {
            end(&mut self.links[v][r]);
            self.links[v][r].since = self.now;
            self.announce(v, r);
        }
    }

    /// A file for a reload: another library or, in one of four cases, none.
    fn other_file(&mut self) -> File {
        match self.rng.random_range(0..4) {
            0 => File::Broken,
            1 => File::Library(1),
            _ => File::Library(2),
        }
    }

    /// A vehicle sees a token appear or go, if that is still so and it did not see it before.
    pub(crate) fn token(&mut self, v: usize, r: usize, alive: bool) {
        let process = &self.replicas[r];
        let link = self.links[v][r];
        let silent = process.frozen > 0 || !link.asks_pass() || !link.answers_pass();
        let announced = matches!(process.stage, Stage::Serving | Stage::Terminated);
        let routed = !self.routers.routes(v, r).is_empty();
        let there = process.machine.is_some() && announced && !silent && routed;
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
            self.vehicles[v].driver.replica_appeared(replica);
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
        let request = Request::decode(&self.last_request);
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
            way: None,
            outbox: self.outbox.clone(),
            answers: Rc::default(),
            copies: Rc::default(),
        };
        self.arrive(r, incarnation, exchange);
    }
}
