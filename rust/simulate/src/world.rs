//! The simulation: state, the loop over events, and the control periods.

use std::time::{Duration, Instant};

use egp_wire::{KeyError, KeyRing};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::config::{Config, Run};
use crate::event::{Agenda, Event};
use crate::fault::draw;
use crate::ledger::Ledger;
use crate::link::Link;
use crate::mutant::Mutant;
use crate::oracle::{Oracle, Violation};
use crate::replica::{Outbox, Process};
use crate::router::Routers;
use crate::scene::{Scene, SimulationError};
use crate::trace::Trace;
use crate::vehicle::{FLEET, Vehicle};

/// Vehicles that may wait in a replica.
pub(crate) const QUEUE: usize = 8;
pub(crate) struct World<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) config: Config,
    pub(crate) rng: ChaCha8Rng,
    pub(crate) now: Duration,
    /// The instant of virtual time zero; only differences matter.
    pub(crate) epoch: Instant,
    pub(crate) agenda: Agenda,
    pub(crate) vehicles: Vec<Vehicle>,
    pub(crate) replicas: Vec<Process>,
    /// By vehicle and replica.
    pub(crate) links: Vec<Vec<Link>>,
    pub(crate) routers: Routers,
    pub(crate) outbox: Outbox,
    pub(crate) ledger: Ledger,
    pub(crate) trace: Trace,
    pub(crate) run: Run,
    pub(crate) dt: Duration,
    /// The secret keys of the vehicles, if they have some.
    pub(crate) keys: Option<KeyRing>,
    /// The newest request of any vehicle, which floods send again.
    pub(crate) last_request: Vec<u8>,
    /// Number of events that are planned at the start.
    pub(crate) planned: usize,
}

/// Simulates one run.
///
/// # Errors
/// [`SimulationError`] if the scene does not fit the simulation; broken promises are in the result.
pub fn simulate(scene: &Scene, config: &Config) -> Result<Run, SimulationError> {
    let served = scene.engines[0].describe();
    let other = scene.engines[1].describe();
    // Vehicles of two libraries drive in the same control periods.
    let two_libraries = config.two_libraries && other.dt.to_bits() == served.dt.to_bits();
    let config = &Config {
        two_libraries,
        ..config.clone()
    };
    let keys = config.keys.then(|| keys(config.vehicles)).transpose()?;
    let vehicles = (0..config.vehicles)
        .map(|index| {
            let with_other = two_libraries && index + 1 == config.vehicles;
            let served = if with_other { &other } else { &served };
            Vehicle::new(index, scene, served.clone(), keys.as_ref(), config.mutant)
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut world = World {
        scene,
        config: config.clone(),
        rng: ChaCha8Rng::seed_from_u64(config.seed),
        now: Duration::ZERO,
        epoch: Instant::now(),
        agenda: Agenda::default(),
        vehicles,
        replicas: (0..config.replicas).map(|_| Process::new()).collect(),
        links: vec![vec![Link::default(); config.replicas]; config.vehicles],
        routers: Routers::new(config.routers, config.vehicles, config.replicas),
        outbox: Outbox::default(),
        ledger: Ledger::default(),
        trace: Trace::new(config.recorded),
        run: Run::default(),
        dt: Duration::from_secs_f64(served.dt),
        keys,
        last_request: Vec::new(),
        planned: 0,
    };
    world.plan()?;
    world.planned = world.agenda.len();
    world.run()?;
    let World { trace, mut run, .. } = world;
    (run.hash, run.trace) = trace.finish();
    Ok(run)
}

/// A secret key for each vehicle.
fn keys(vehicles: usize) -> Result<KeyRing, KeyError> {
    let lines = (0..vehicles).map(|v| format!("{FLEET}/car-{v} {v:064x}\n"));
    KeyRing::parse(&lines.collect::<String>())
}

/// Simulates a run twice and compares the traces.
///
/// # Errors
/// As [`simulate`].
pub fn repeat(scene: &Scene, config: &Config) -> Result<Run, SimulationError> {
    let mut run = simulate(scene, config)?;
    if simulate(scene, config)?.hash != run.hash {
        run.violations.push(Violation {
            oracle: Oracle::Repeat,
            at: Duration::from_secs_f64(config.seconds),
            detail: "two runs of one seed have different traces".to_owned(),
        });
    }
    Ok(run)
}

impl World<'_> {
    /// Plans the starts, the first periods and the faults.
    fn plan(&mut self) -> Result<(), SimulationError> {
        let Config {
            vehicles,
            replicas,
            routers,
            ..
        } = self.config;
        self.connect_vehicles();
        for r in 0..self.config.replicas {
            self.agenda.add(Duration::ZERO, Event::Start(r));
        }
        for v in 0..self.config.vehicles {
            let phase = Duration::from_micros(self.rng.random_range(200_000..220_000));
            self.agenda.add(phase, Event::Period(v));
        }
        if !self.config.faults.is_empty() {
            for scheduled in &self.config.faults {
                if !scheduled.fits(vehicles, replicas, routers) {
                    return Err(SimulationError::Schedule(*scheduled));
                }
                let event = Event::Begin(scheduled.fault, scheduled.length);
                self.agenda.add(scheduled.begin, event);
            }
            return Ok(());
        }
        let mut at = Duration::from_millis(600);
        // The last quarter has no new faults, so that every run also shows the return.
        while at.as_secs_f64() < 0.75 * self.config.seconds {
            let (fault, length) = draw(&mut self.rng, vehicles, replicas, routers);
            self.agenda.add(at, Event::Begin(fault, length));
            at += Duration::from_micros(self.rng.random_range(50_000..1_200_000));
        }
        Ok(())
    }

    fn run(&mut self) -> Result<(), SimulationError> {
        let end = Duration::from_secs_f64(self.config.seconds);
        while let Some((due, event)) = self.agenda.next() {
            if due > end {
                break;
            }
            self.now = due;
            self.happen(event)?;
            self.flush();
        }
        Ok(())
    }

    pub(crate) fn happen(&mut self, event: Event) -> Result<(), SimulationError> {
        match event {
            Event::Period(v) => self.period(v)?,
            Event::Wake(v) => {
                if self.config.mutant != Some(Mutant::NoDeadline) {
                    let now = self.time_of(v);
                    self.vehicles[v].driver.wake(now);
                    self.act(v);
                }
            }
            Event::Arrive(r, incarnation, exchange) => self.arrive(r, incarnation, exchange),
            Event::Work(r, incarnation) => {
                if self.replicas[r].incarnation == incarnation {
                    self.work(r);
                }
            }
            Event::StepEnds(r, incarnation, worker) => self.step_ends(r, incarnation, worker),
            Event::Deliver(v, id, message) => self.deliver(v, id, message),
            Event::Token(v, r, alive) => self.token(v, r, alive),
            Event::Begin(fault, length) => self.begin(fault, length)?,
            Event::Finish(fault) => self.finish(fault)?,
            Event::Thaw(r, incarnation) => self.thaw(r, incarnation)?,
            Event::Undeclare(r, incarnation) => self.undeclare(r, incarnation),
            Event::Start(r) => self.start(r)?,
            Event::Flood(r, left) => self.flood(r, left),
            Event::Loaded(r, incarnation, file) => self.loaded(r, incarnation, file),
            Event::Connect(attempt) => self.attempt(attempt),
            Event::Lease(node, k, turn) => self.lease_ends(node, k, turn),
            Event::StartRouter(k) => self.start_router(k),
        }
        Ok(())
    }

    /// The time that is passed to a vehicle's driver: that of the vehicle's clock.
    pub(crate) fn time_of(&self, v: usize) -> Duration {
        match self.config.mutant {
            Some(Mutant::StandingClock) => self.now,
            _ => self.now + self.vehicles[v].clock,
        }
    }

    pub(crate) fn note(&mut self, text: &str) {
        self.trace.line(self.now, text);
    }

    /// Notes a broken promise; of each oracle the first one is kept.
    pub(crate) fn broken(&mut self, oracle: Oracle, detail: String) {
        self.note(&format!("BROKEN {oracle:?}: {detail}"));
        if self.run.violations.iter().all(|seen| seen.oracle != oracle) {
            let at = self.now;
            self.run.violations.push(Violation { oracle, at, detail });
        }
    }
}
