//! The simulation: state, the loop over events, and the control periods.

use std::time::{Duration, Instant};

use egp_driver::{Action, Step};
use egp_wire::{KeyError, KeyRing};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::event::{Agenda, Event};
use crate::fault::{ScheduledFault, draw};
use crate::ledger::Ledger;
use crate::link::Link;
use crate::mutant::Mutant;
use crate::oracle::{Oracle, Violation};
use crate::replica::{Outbox, Process};
use crate::scene::{Scene, SimulationError};
use crate::trace::Trace;
use crate::vehicle::{FLEET, Vehicle};

/// A run.
#[derive(Clone, Debug)]
pub struct Config {
    /// The seed of all that is random.
    pub seed: u64,
    /// Number of vehicles.
    pub vehicles: usize,
    /// Number of replicas.
    pub replicas: usize,
    /// Virtual duration, s.
    pub seconds: f64,
    /// Whether vehicles and replicas have secret keys.
    pub keys: bool,
    /// Faults in place of those that are drawn from the seed, unless it is empty.
    pub faults: Vec<ScheduledFault>,
    /// Whether the whole trace is kept.
    pub recorded: bool,
    /// A planted fault.
    pub mutant: Option<Mutant>,
}

impl Config {
    /// Three vehicles and three replicas for ten seconds, with secret keys if the seed is odd.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            vehicles: 3,
            replicas: 3,
            seconds: 10.0,
            keys: !seed.is_multiple_of(2),
            faults: Vec::new(),
            recorded: false,
            mutant: None,
        }
    }
}

/// The result of a run.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Hash of the whole trace.
    pub hash: u64,
    /// The trace, or its end if the run is not recorded.
    pub trace: Vec<String>,
    /// Broken promises, the first of each oracle.
    pub violations: Vec<Violation>,
    /// Control periods.
    pub periods: u64,
    /// Control periods with a usable reply.
    pub replied: u64,
    /// Faults that began.
    pub faults: u64,
}

/// Time without a reply, with a sound replica in reach, after which a vehicle starves.
const STARVING: Duration = Duration::from_secs(3);
/// Vehicles that may wait in a replica.
pub(crate) const QUEUE: usize = 8;
/// Most queries of a vehicle that may be outstanding: the listening time in periods, with several replicas asked.
const OUTSTANDING: usize = 200;
/// Most events that may be planned.
const AGENDA: usize = 20_000;

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
    pub(crate) outbox: Outbox,
    pub(crate) ledger: Ledger,
    pub(crate) trace: Trace,
    pub(crate) run: Run,
    pub(crate) dt: Duration,
    /// The secret keys of the vehicles, if they have some.
    pub(crate) keys: Option<KeyRing>,
    /// The newest request of any vehicle, which floods send again.
    pub(crate) last_request: Vec<u8>,
}

/// Simulates one run.
///
/// # Errors
/// [`SimulationError`] if the scene does not fit the simulation; broken promises are in the result.
pub fn simulate(scene: &Scene, config: &Config) -> Result<Run, SimulationError> {
    let served = scene.engine.describe();
    let keys = config.keys.then(|| keys(config.vehicles)).transpose()?;
    let vehicles = (0..config.vehicles)
        .map(|index| Vehicle::new(index, scene, served.clone(), keys.as_ref(), config.mutant))
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
        outbox: Outbox::default(),
        ledger: Ledger::default(),
        trace: Trace::new(config.recorded),
        run: Run::default(),
        dt: Duration::from_secs_f64(served.dt),
        keys,
        last_request: Vec::new(),
    };
    world.plan()?;
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
        for r in 0..self.config.replicas {
            self.agenda.add(Duration::ZERO, Event::Start(r));
        }
        for v in 0..self.config.vehicles {
            let phase = Duration::from_micros(self.rng.random_range(200_000..220_000));
            self.agenda.add(phase, Event::Period(v));
        }
        if !self.config.faults.is_empty() {
            for scheduled in &self.config.faults {
                if !scheduled.fits(self.config.vehicles, self.config.replicas) {
                    return Err(SimulationError::Schedule(scheduled.fault));
                }
                let (begin, fault) = (scheduled.begin, scheduled.fault);
                self.agenda.add(begin, Event::Begin(fault));
                let end = begin.saturating_add(scheduled.length);
                self.agenda.add(end, Event::Finish(fault));
            }
            return Ok(());
        }
        let mut at = Duration::from_millis(600);
        // The last quarter has no new faults, so that every run also shows the return.
        while at.as_secs_f64() < 0.75 * self.config.seconds {
            let (fault, length) = draw(&mut self.rng, self.config.vehicles, self.config.replicas);
            self.agenda.add(at, Event::Begin(fault));
            self.agenda.add(at + length, Event::Finish(fault));
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

    fn happen(&mut self, event: Event) -> Result<(), SimulationError> {
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
            Event::StepEnds(r, incarnation, worker) => self.step_ends(r, incarnation, worker),
            Event::Deliver(v, id, message) => self.deliver(v, id, message),
            Event::Token(v, r, alive) => self.token(v, r, alive),
            Event::Begin(fault) => self.begin(fault)?,
            Event::Finish(fault) => self.finish(fault)?,
            Event::Undeclare(r, incarnation) => self.undeclare(r, incarnation),
            Event::Start(r) => self.start(r)?,
            Event::Flood(r, left) => self.flood(r, left),
        }
        Ok(())
    }

    /// The time on a vehicle's clock.
    pub(crate) fn time_of(&self, v: usize) -> Duration {
        self.now + self.vehicles[v].clock
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

    /// Ends a vehicle's control period and begins the next one.
    fn period(&mut self, v: usize) -> Result<(), SimulationError> {
        if self.vehicles[v].deadline > Duration::ZERO && self.vehicles[v].witness.commands == 0 {
            self.broken(Oracle::Command, format!("car-{v} has no command"));
        }
        self.check(v);
        let (scene, dt) = (self.scene, self.dt);
        if self.vehicles[v].drive(scene, dt.as_secs_f64())? {
            self.note(&format!("car-{v} is put back on its course"));
            self.vehicles[v].witness.replied = self.now;
        }
        let measurement = self.vehicles[v].measure(scene)?;
        let budget = self.vehicles[v].driver.budget();
        let now = self.time_of(v);
        let vehicle = &mut self.vehicles[v];
        vehicle.witness.begin();
        vehicle.deadline = self.now + budget;
        vehicle.driver.tick(now, now + budget, measurement)?;
        self.run.periods += 1;
        let hedge = vehicle.driver.next_wake().map(|at| at.saturating_sub(now));
        for wait in hedge
            .filter(|hedge| *hedge < budget)
            .into_iter()
            .chain([budget])
        {
            self.agenda.add(self.now + wait, Event::Wake(v));
        }
        self.agenda.add(self.now + dt, Event::Period(v));
        self.act(v);
        Ok(())
    }

    /// The oracles that need no command.
    fn check(&mut self, v: usize) {
        let now = self.now;
        let reached = |(r, process): (usize, &Process)| {
            let link = self.links[v][r];
            let open = link.cut + link.half == 0;
            Some(process.sound_since.filter(|_| open)?.max(link.since))
        };
        // The longest time for which one sound replica was within reach; none if there is no such replica.
        let since = self.replicas.iter().enumerate().filter_map(reached).min();
        let vehicle = &self.vehicles[v];
        let replied = since.map(|since| since.max(vehicle.witness.replied));
        if replied.is_some_and(|last| now.saturating_sub(last) > STARVING) {
            self.broken(Oracle::Starvation, format!("car-{v} gets no reply"));
        }
        let outstanding = self.vehicles[v].outstanding.len();
        if outstanding > OUTSTANDING || self.agenda.len() > AGENDA {
            self.broken(Oracle::Memory, format!("{outstanding} queries of car-{v}"));
        }
        for r in 0..self.replicas.len() {
            let waiting = self.replicas[r]
                .machine
                .as_ref()
                .map_or(0, egp_service::Replica::waiting);
            if waiting > QUEUE {
                self.broken(Oracle::Memory, format!("{waiting} vehicles wait in r{r}"));
            }
            self.unanswered(r);
        }
    }

    /// Carries out what a vehicle's driver asks for.
    pub(crate) fn act(&mut self, v: usize) {
        while let Some(action) = self.vehicles[v].driver.next_action() {
            match action {
                Action::Ask(query) => {
                    self.vehicles[v].witness.asked(&query.payload);
                    self.ask(v, query);
                }
                Action::Probe(query) => self.ask(v, query),
                Action::Command(step) => self.command(v, *step),
            }
        }
    }

    fn command(&mut self, v: usize, mut step: Step) {
        let times = self.spoil(v, &mut step);
        let late = self.config.mutant == Some(Mutant::LateCommand);
        let at = if late { self.now + self.dt } else { self.now };
        if at > self.vehicles[v].deadline {
            self.broken(Oracle::Command, format!("a command of car-{v} is late"));
        }
        for _ in 0..times {
            let broken = {
                let vehicle = &mut self.vehicles[v];
                vehicle.u = step.command.u;
                vehicle.witness.judge(self.now, &step, &self.ledger)
            };
            for (oracle, detail) in broken {
                self.broken(oracle, format!("car-{v}: {detail}"));
            }
        }
        self.run.replied += u64::from(step.reply.is_some());
        let [force, rate] = step.command.u;
        let speed = self.vehicles[v].speed();
        self.note(&format!(
            "car-{v} {:?} F {force:.3} N, rate {rate:.6} rad/s at {speed:.4} m/s, {} of {}",
            step.command.mode,
            step.outcome.name(),
            step.replica
                .as_ref()
                .map_or("none", egp_wire::keys::Name::as_str),
        ));
    }

    /// Plants a fault into a command. Returns how often the command is given.
    fn spoil(&mut self, v: usize, step: &mut Step) -> u32 {
        use egp_gate::Mode;
        let Some(mutant) = self.config.mutant.filter(|_| v == 0) else {
            return 1;
        };
        let limits = egp_gate::Limits::of(&crate::scene::CAR.vehicle());
        let late = self.now > Duration::from_secs(1);
        let command = &mut step.command;
        match mutant {
            Mutant::NoCommand if late => return 0,
            Mutant::TwoCommands if late => return 2,
            Mutant::Braking if late => command.u[0] = 1.01 * limits.force_min,
            Mutant::Driving if late => command.u[0] = 1.01 * limits.force_max,
            Mutant::ForceSlew if late => {
                let step = 1.5 * limits.force_slew * self.dt.as_secs_f64();
                command.u[0] = self.vehicles[v].u[0] - step;
            }
            Mutant::SteeringRate if late => command.u[1] = 1.01 * limits.steering_rate,
            Mutant::SteeringSlew if late => {
                let step = 1.5 * limits.steering_slew * self.dt.as_secs_f64();
                command.u[1] = self.vehicles[v].u[1] - step;
            }
            Mutant::NotFinite if late => command.u[1] = f64::NAN,
            Mutant::TailAsNormal if command.mode == Mode::Tail => command.mode = Mode::Normal,
            Mutant::TailShifted if command.mode == Mode::Tail => {
                command.u = self.vehicles[v].u;
                command.limited = false;
            }
            Mutant::StopRepeats if command.mode == Mode::Stop => {
                command.u[0] = self.vehicles[v].u[0].abs().max(1.0);
                command.limited = false;
            }
            _ => {}
        }
        1
    }
}
