//! How queries and answers travel between vehicles and replicas.

use std::rc::Rc;
use std::time::Duration;

use egp_driver::{Query, QueryId};
use egp_wire::{Code, WireError};
use rand::RngExt;

use crate::event::{Event, Message};
use crate::link::latency;
use crate::mutant::Mutant;
use crate::oracle::{Oracle, typed};
use crate::replica::{Exchange, Received, Sent};
use crate::router::{Route, Way};
use crate::tampering::real_micros;
use crate::world::World;

/// Time after its arrival within which a running replica answers a query.
const ANSWERED: Duration = Duration::from_secs(1);
/// Time within which a replica without a fault begins a step if requests wait, even while it loads a library.
const PROMPT: Duration = Duration::from_millis(50);
/// Time in which an idle worker wakes, µs.
const WAKE: std::ops::Range<u64> = 20..300;
/// Time of a step, µs.
const STEP: std::ops::Range<u64> = 800..2500;

impl World<'_> {
    /// Sends a query of a vehicle.
    pub(crate) fn ask(&mut self, v: usize, query: Query) {
        let index = query.replica.as_str().trim_start_matches('r').parse();
        let Some(r) = index.ok().filter(|r: &usize| *r < self.replicas.len()) else {
            return;
        };
        self.note(&format!("car-{v} asks r{r} as query {}", query.id.0));
        self.vehicles[v].outstanding.push((query.id, r, self.now));
        if !query.payload.is_empty() {
            self.last_request.clone_from(&query.payload);
        }
        // A query that is not answered ends when its time has passed.
        self.agenda.add(
            self.now + query.listen,
            Event::Deliver(v, query.id, Message::End),
        );
        let delay = latency(&mut self.rng);
        if !self.links[v][r].asks_pass() {
            return;
        }
        let process = &self.replicas[r];
        let end = Event::Deliver(v, query.id, Message::End);
        let routes = self.routers.routes(v, r);
        let Some((first, others)) = routes.split_first() else {
            self.agenda.add(self.now + delay, end);
            return;
        };
        if process.machine.is_none() || !process.declared() {
            self.send((v, r), delay, std::iter::once(end));
            return;
        }
        let incarnation = process.incarnation;
        let exchange = Exchange {
            key: query.key,
            payload: query.payload,
            attachment: query.attachment,
            asker: Some((v, query.id)),
            way: first.way,
            outbox: self.outbox.clone(),
            answers: Rc::default(),
            copies: Rc::default(),
        };
        let copies: Vec<Exchange> = others
            .iter()
            .map(|route| exchange.copy(route.way))
            .collect();
        let arrivals = std::iter::once(exchange)
            .chain(copies)
            .map(|copy| Event::Arrive(r, incarnation, copy));
        self.send((v, r), delay, arrivals);
    }

    /// A query reaches a replica.
    pub(crate) fn arrive(&mut self, r: usize, incarnation: u32, mut exchange: Exchange) {
        let process = &mut self.replicas[r];
        if process.incarnation != incarnation || !process.declared() {
            return;
        }
        if process.frozen > 0 {
            let event = Event::Arrive(r, incarnation, exchange);
            process.deferred.push(event);
            return;
        }
        let victim = matches!(exchange.asker, Some((0, _)));
        match self.config.mutant {
            Some(Mutant::DroppedVehicle) if victim => return,
            Some(Mutant::TwoAnswers) if victim => {
                let error = WireError::retryable(Code::Overloaded, 0, "planted");
                egp_service::Query::refuse(&exchange, &error);
            }
            Some(Mutant::RefusedVehicle) if victim => {
                let error = WireError::retryable(Code::Overloaded, 0, "planted");
                egp_service::Query::refuse(&exchange, &error);
                return;
            }
            Some(Mutant::ChangedRequest) if victim => {
                let changed = egp_wire::Request::decode(&exchange.payload);
                if let Ok(mut request) = changed {
                    request.reference.iter_mut().for_each(|row| row[2] *= 0.9);
                    exchange.payload = request.encode();
                }
            }
            _ => {}
        }
        let Some(machine) = &process.machine else {
            return;
        };
        let answers = exchange.answers.clone();
        if self.config.mutant == Some(Mutant::DroppedRequest) && self.rng.random_range(0..50) == 0 {
            drop(exchange);
        } else {
            machine.take(exchange, self.epoch + self.now + process.clock);
        }
        let at = self.now;
        process.received.push(Received { at, answers });
        let due = at + Duration::from_micros(self.rng.random_range(WAKE));
        self.agenda.add(due, Event::Work(r, incarnation));
    }

    /// Lets idle workers of a replica begin steps.
    pub(crate) fn work(&mut self, r: usize) {
        let process = &mut self.replicas[r];
        if process.frozen > 0 {
            return;
        }
        let now = self.epoch + self.now + process.clock;
        if process.loading && self.config.mutant == Some(Mutant::BlockingReload) {
            return;
        }
        let uptime = (self.now + process.clock).saturating_sub(process.started);
        if let Some(libraries) = &process.libraries {
            libraries.uptime.set(uptime);
        }
        let Some(machine) = &mut process.machine else {
            return;
        };
        while let Some(worker) = machine.begin(now) {
            process.progress = self.now;
            let slow = if process.slow > 0 { 12 } else { 1 };
            let mut micros = slow * self.rng.random_range(STEP);
            match self.config.mutant {
                Some(Mutant::StuckWorker) => continue,
                Some(Mutant::RealClock) => micros += real_micros(),
                _ => {}
            }
            let due = self.now + Duration::from_micros(micros);
            self.agenda
                .add(due, Event::StepEnds(r, process.incarnation, worker));
        }
    }

    /// A step has taken its time.
    pub(crate) fn step_ends(&mut self, r: usize, incarnation: u32, worker: usize) {
        let process = &mut self.replicas[r];
        if process.incarnation != incarnation {
            return;
        }
        if process.frozen > 0 {
            let event = Event::StepEnds(r, incarnation, worker);
            process.deferred.push(event);
            return;
        }
        let now = self.epoch + self.now + process.clock;
        if let Some(machine) = &mut process.machine {
            machine.end(worker, now);
        }
        self.flush_from(r);
        self.work(r);
    }

    /// Puts what replicas have sent on the links.
    pub(crate) fn flush(&mut self) {
        for r in 0..self.replicas.len() {
            self.flush_from(r);
        }
    }

    fn flush_from(&mut self, r: usize) {
        let mut sent = std::mem::take(&mut *self.outbox.borrow_mut());
        if self.config.mutant == Some(Mutant::RandomOrder)
            && sent.len() > 1
            && real_micros().is_multiple_of(2)
        {
            sent.reverse();
        }
        for Sent {
            asker,
            way,
            message,
        } in sent
        {
            let message = self.plant_error(message);
            if matches!(&message, Message::Error(bytes) if !typed(bytes)) {
                self.broken(Oracle::Typed, format!("r{r} sent an error without a code"));
            }
            let Some((v, id)) = asker else {
                continue;
            };
            let outstanding = &self.vehicles[v].outstanding;
            let asked = outstanding.iter().find(|(own, ..)| *own == id);
            let r = asked.map_or(r, |(_, asked, _)| *asked);
            self.judge_library(v, r, &message);
            self.travel((v, r), way, id, message);
        }
    }

    /// Puts a replica's answer on the links by which its question came.
    fn travel(&mut self, (v, r): (usize, usize), way: Option<Way>, id: QueryId, message: Message) {
        let mut delay = latency(&mut self.rng);
        if !self.links[v][r].answers_pass() {
            return;
        }
        if self.config.mutant == Some(Mutant::LostAnswers) && v == 0 {
            return;
        }
        let process = &mut self.replicas[r];
        if process.disorder > 0 {
            delay += Duration::from_micros(self.rng.random_range(0..40_000));
            if self.rng.random::<bool>() {
                let again = delay + Duration::from_micros(self.rng.random_range(0..5000));
                self.agenda
                    .add(self.now + again, Event::Deliver(v, id, message.clone()));
            }
        }
        let hostile = process.hostile > 0;
        let old = process.old_answer.clone();
        if matches!(message, Message::Reply(..)) {
            process.old_answer = Some(message.clone());
        }
        let message = match message {
            Message::Reply(payload, attachment) => {
                let payload = if hostile {
                    self.corrupt(payload, old.as_ref())
                } else {
                    self.plant(v, payload, old.as_ref())
                };
                Message::Reply(payload, attachment)
            }
            other => other,
        };
        // An answer is lost with a link of its question. A query also ends when such a link closes.
        let stands = |route: &Route| route.way == way;
        let route = self.routers.routes(v, r).into_iter().find(stands);
        let ends = matches!(message, Message::End);
        if route.is_none() && !ends {
            return;
        }
        let hops = route.map_or(0, |route| route.hops);
        let hops: Duration = (0..hops).map(|_| latency(&mut self.rng)).sum();
        // The end of a query does not overtake its answers.
        let holder = ends.then(|| self.routers.holder(v, id)).flatten();
        let frozen = holder.or(route.and_then(|route| route.frozen));
        let mut due = self.now + delay + hops;
        let mut asked = self.vehicles[v].outstanding.iter_mut();
        if let Some((_, _, last)) = asked.find(|(own, ..)| *own == id) {
            due = due.max(*last);
            *last = due;
        }
        let event = Event::Deliver(v, id, message);
        match frozen {
            Some(k) => self.routers.each[k].held.push((v, r, event)),
            None => self.agenda.add(due, event),
        }
    }

    /// A message reaches a vehicle.
    pub(crate) fn deliver(&mut self, v: usize, id: QueryId, message: Message) {
        let now = self.time_of(v);
        let vehicle = &mut self.vehicles[v];
        let known = vehicle.outstanding.iter().any(|(own, ..)| *own == id);
        if !known {
            return;
        }
        match message {
            Message::Reply(payload, attachment) => {
                vehicle.driver.replied(now, id, &payload, &attachment);
            }
            Message::Error(error) => vehicle.driver.refused(now, id, &error),
            Message::End => {
                if self.config.mutant != Some(Mutant::LeakedQueries) {
                    vehicle.outstanding.retain(|(own, ..)| *own != id);
                }
                vehicle.driver.ended(now, id);
            }
        }
        self.act(v);
    }

    /// Ends a vehicle's queries to a replica whose link is lost.
    pub(crate) fn end_queries(&mut self, v: usize, r: usize) {
        let ended: Vec<QueryId> = self.vehicles[v]
            .outstanding
            .iter()
            .filter(|(_, asked, _)| *asked == r)
            .map(|(id, ..)| *id)
            .collect();
        for id in ended {
            self.agenda
                .add(self.now, Event::Deliver(v, id, Message::End));
        }
    }

    /// Checks that a running replica has answered each query once.
    pub(crate) fn unanswered(&mut self, r: usize) {
        let now = self.now;
        let process = &mut self.replicas[r];
        if process.frozen > 0 || process.machine.is_none() {
            return;
        }
        let waits = process.machine.as_ref().is_some_and(|m| m.waiting() > 0);
        if !waits {
            process.progress = now;
        }
        let progress = process.sound_since.map(|since| since.max(process.progress));
        let stuck = progress.is_some_and(|last| now.saturating_sub(last) > PROMPT);
        let waited = |received: &Received| now.saturating_sub(received.at) > ANSWERED;
        let wrong = process
            .received
            .iter()
            .filter(|received| waited(received) && received.answers.get() != 1)
            .count();
        process.received.retain(|received| !waited(received));
        if stuck {
            let detail = format!("r{r} is sound and begins no step for {PROMPT:?}");
            self.broken(Oracle::Answered, detail);
        }
        if wrong > 0 {
            self.broken(
                Oracle::Answered,
                format!("r{r} did not answer {wrong} queries exactly once"),
            );
        }
    }
}
