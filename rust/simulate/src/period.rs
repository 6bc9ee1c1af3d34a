//! The control periods of a vehicle, with the oracles that look at each one.

use std::time::Duration;

use egp_driver::{Action, Step};

use crate::event::Event;
use crate::mutant::Mutant;
use crate::oracle::Oracle;
use crate::replica::Process;
use crate::scene::SimulationError;
use crate::world::{QUEUE, World};

/// The longest outage after everything is sound again.
const OUTAGE: Duration = Duration::from_secs(1);
/// Time without a reply, with a sound replica in reach, after which a vehicle starves.
const STARVING: Duration = Duration::from_secs(3);
/// Most queries of a vehicle that may be outstanding: the listening time in periods, with several replicas asked.
const OUTSTANDING: usize = 200;
/// Most events that may be planned beside those of the start: so many, and so many for each pair of a vehicle and a replica,
/// of which each query is a pair's for 21 periods. Measured were 386 with three of each (seeds 0 to 29), and 53 717 with a
/// hundred of each when their router restarts.
const EVENTS: usize = 1000;
const EVENTS_OF_PAIR: usize = 50;
/// Wake-ups of a planted fault in each period, and when they are due.
const WAKES: usize = 50;
const DISTANT: Duration = Duration::from_secs(86_400);

impl World<'_> {
    /// Ends a vehicle's control period and begins the next one.
    pub(crate) fn period(&mut self, v: usize) -> Result<(), SimulationError> {
        if self.vehicles[v].deadline > Duration::ZERO && self.vehicles[v].oracles.commands == 0 {
            self.broken(Oracle::Command, format!("car-{v} has no command"));
        }
        self.check(v);
        let (scene, dt) = (self.scene, self.dt);
        if self.vehicles[v].drive(scene, dt.as_secs_f64())? {
            self.note(&format!("car-{v} is put back on its course"));
        }
        let measurement = self.vehicles[v].measure(scene)?;
        let budget = self.vehicles[v].driver.budget();
        let now = self.time_of(v);
        let vehicle = &mut self.vehicles[v];
        vehicle.oracles.begin(self.now + vehicle.clock);
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
        if self.config.mutant == Some(Mutant::LeakedWakes) {
            for _ in 0..WAKES {
                self.agenda.add(DISTANT, Event::Wake(v));
            }
        }
        self.act(v);
        Ok(())
    }

    /// The oracles that need no command.
    fn check(&mut self, v: usize) {
        let now = self.now;
        let library = self.vehicles[v].driver.served().library;
        // Time since which the replica and its link to the vehicle have been sound and the replica has served the vehicle's
        // library. Routes are not considered here.
        let sound = |(r, process): (usize, &Process)| {
            let link = self.links[v][r];
            let served = *process.served.get(&library)?;
            let sound = process.sound_since.filter(|_| link.cut + link.half == 0)?;
            Some(sound.max(link.since).max(served))
        };
        let routers: Option<Vec<Duration>> = self.routers.sound().collect();
        let routers = routers.map(|since| since.into_iter().max().unwrap_or_default());
        let reached = |(r, process): (usize, &Process)| {
            let routed = self.routers.open(v, r);
            let routed = routed.then_some(self.routers.since[v][r]);
            // If all routers are sound, the time counts from that moment, even before there is a route; otherwise from the
            // start of the route.
            let routed = routers.or(routed)?;
            Some(sound((r, process))?.max(routed))
        };
        let replicas = || self.replicas.iter().enumerate();
        // The longest time for which one sound replica was within reach; none if there is no such replica.
        let since = replicas().filter_map(reached).min();
        // The time since all replicas and routers are sound; none if one is not.
        let all = replicas().map(sound).chain([routers]);
        let all = all.collect::<Option<Vec<_>>>();
        let all = all.and_then(|since| since.into_iter().max());
        let vehicle = &self.vehicles[v];
        let replied = since.map(|since| since.max(vehicle.oracles.replied));
        if replied.is_some_and(|last| now.saturating_sub(last) > STARVING) {
            self.broken(Oracle::Starvation, format!("car-{v} gets no reply"));
        }
        let last = all.map(|since| since.max(self.vehicles[v].oracles.replied));
        if last.is_some_and(|last| now.saturating_sub(last) > OUTAGE) {
            self.broken(
                Oracle::Outage,
                format!("car-{v} gets no reply a second after everything is sound"),
            );
        }
        self.check_memory(v);
        for r in 0..self.replicas.len() {
            self.unanswered(r);
        }
    }

    /// What a vehicle, each replica and the simulation itself hold is bounded.
    fn check_memory(&mut self, v: usize) {
        let outstanding = self.vehicles[v].outstanding.len();
        if outstanding > OUTSTANDING {
            self.broken(Oracle::Memory, format!("{outstanding} queries of car-{v}"));
        }
        let pairs = self.vehicles.len() * self.replicas.len();
        let most = self.planned + EVENTS + EVENTS_OF_PAIR * pairs;
        let events = self.agenda.len();
        if events > most {
            let detail = format!("{events} events are planned, expected are at most {most}");
            self.broken(Oracle::Memory, detail);
        }
        for r in 0..self.replicas.len() {
            let machine = self.replicas[r].machine.as_ref();
            let waiting = machine.map_or(0, egp_service::Replica::waiting);
            if waiting > QUEUE {
                self.broken(Oracle::Memory, format!("{waiting} vehicles wait in r{r}"));
            }
        }
    }

    /// Carries out what a vehicle's driver asks for.
    pub(crate) fn act(&mut self, v: usize) {
        while let Some(action) = self.vehicles[v].driver.next_action() {
            match action {
                Action::Ask(query) => {
                    self.vehicles[v].oracles.asked(&query.payload);
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
                let measured = vehicle.motion();
                let (ledger, time) = (&self.ledger, self.now + vehicle.clock);
                vehicle
                    .oracles
                    .judge(self.now, time, measured, &step, ledger)
            };
            for (oracle, detail) in broken {
                self.broken(oracle, format!("car-{v}: {detail}"));
            }
        }
        self.run.replied += u64::from(step.reply.is_some());
        let [force, rate] = step.command.u;
        let [speed, _] = self.vehicles[v].motion();
        self.note(&format!(
            "car-{v} {:?} F {force:.3} N, rate {rate:.6} rad/s at {speed:.4} m/s, {} of {}",
            step.command.mode,
            step.outcome.name(),
            step.replica
                .as_ref()
                .map_or("none", egp_wire::keys::Name::as_str),
        ));
    }
}
