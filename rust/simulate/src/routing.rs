//! What happens to links when routers end, stand still and begin.

use std::time::Duration;

use crate::event::{Event, Message};
use crate::link::{latency, lease, token_delay};
use crate::mutant::Mutant;
use crate::router::{Attempt, Node, handshake};
use crate::world::World;

/// The wait of a planted fault.
const MINUTE: Duration = Duration::from_secs(60);

impl World<'_> {
    /// Connects all vehicles to all routers.
    pub(crate) fn connect_vehicles(&mut self) {
        for v in 0..self.config.vehicles {
            for k in 0..self.config.routers {
                self.connect(Node::Vehicle(v), k);
            }
        }
    }

    /// Begins to connect a vehicle to a router, or a replica to the first router that answers.
    pub(crate) fn connect(&mut self, node: Node, router: usize) {
        if self.routers.direct() {
            return;
        }
        let epoch = match node {
            Node::Vehicle(v) => &mut self.routers.uplinks[v][router].epoch,
            Node::Replica(r) => &mut self.routers.replica_links[r].epoch,
        };
        *epoch += 1;
        let attempt = Attempt {
            node,
            router,
            epoch: *epoch,
            number: 0,
        };
        let due = self.now + handshake(&mut self.rng);
        self.agenda.add(due, Event::Connect(attempt));
    }

    /// An attempt to connect reaches a router, or finds that none listens.
    pub(crate) fn attempt(&mut self, attempt: Attempt) {
        let (epoch, router) = match attempt.node {
            Node::Vehicle(v) => (
                self.routers.uplinks[v][attempt.router].epoch,
                Some(attempt.router),
            ),
            Node::Replica(r) => (self.routers.replica_links[r].epoch, self.routers.first()),
        };
        if epoch != attempt.epoch || !self.can_connect(attempt.node) {
            return;
        }
        let runs = |k: &usize| self.routers.each[*k].runs;
        let Some(k) = router.filter(runs) else {
            let slow = self.config.mutant == Some(Mutant::SlowReturn);
            let wait = if slow { MINUTE } else { attempt.wait() };
            let due = self.now + wait;
            self.agenda.add(due, Event::Connect(attempt.next()));
            return;
        };
        if self.routers.each[k].frozen > 0 {
            self.routers.each[k].pending_connections.push(attempt);
            return;
        }
        match attempt.node {
            Node::Vehicle(v) => self.routers.uplinks[v][k].stands = true,
            Node::Replica(r) => self.routers.replica_links[r].router = Some(k),
        }
        self.note(&format!("{:?} is linked to router {k}", attempt.node));
        let now = self.now;
        for (v, r) in self.pairs(attempt.node) {
            if self.routers.routes(v, r).len() == 1 {
                self.routers.since[v][r] = now;
            }
            if self.config.mutant != Some(Mutant::MuteRouter) || self.routers.each[k].turn == 0 {
                self.announce(v, r);
            }
        }
    }

    /// A replica that does not run does not connect.
    fn can_connect(&self, node: Node) -> bool {
        match node {
            Node::Vehicle(_) => true,
            Node::Replica(r) => self.replicas[r].machine.is_some(),
        }
    }

    /// The pairs of a vehicle and a replica that one of them belongs to.
    fn pairs(&self, node: Node) -> Vec<(usize, usize)> {
        match node {
            Node::Vehicle(v) => (0..self.replicas.len()).map(|r| (v, r)).collect(),
            Node::Replica(r) => (0..self.vehicles.len()).map(|v| (v, r)).collect(),
        }
    }

    /// Closes the link of a vehicle or a replica to a router; questions that have no other route end, and the tokens of
    /// replicas behind it go.
    fn unlink(&mut self, node: Node, k: usize) {
        match node {
            Node::Vehicle(v) if self.routers.uplinks[v][k].stands => {
                self.routers.uplinks[v][k].stands = false;
            }
            Node::Replica(r) if self.routers.replica_links[r].router == Some(k) => {
                self.routers.replica_links[r].router = None;
            }
            _ => return,
        }
        self.note(&format!("{node:?} has lost router {k}"));
        for (v, r) in self.pairs(node) {
            if self.routers.routes(v, r).is_empty() {
                self.end_queries(v, r);
                let delay = token_delay(&mut self.rng);
                self.agenda.add(self.now + delay, Event::Token(v, r, false));
            }
            let held = &mut self.routers.each[k].held;
            let lost = held.extract_if(.., |(own, asked, _)| (*own, *asked) == (v, r));
            // What waits on the link is lost, but the query ends.
            let ends = lost
                .map(|(.., event)| event)
                .filter(|event| matches!(event, Event::Deliver(.., Message::End)));
            for end in ends {
                self.agenda.add(self.now, end);
            }
        }
    }

    fn nodes(&self) -> Vec<Node> {
        let vehicles = (0..self.vehicles.len()).map(Node::Vehicle);
        vehicles
            .chain((0..self.replicas.len()).map(Node::Replica))
            .collect()
    }

    /// A process of a replica has ended: its link closes.
    pub(crate) fn close_home(&mut self, r: usize) {
        self.routers.replica_links[r].router = None;
        self.routers.replica_links[r].epoch += 1;
    }

    pub(crate) fn kill_router(&mut self, k: usize) {
        let router = &mut self.routers.each[k];
        if !router.runs {
            return;
        }
        router.runs = false;
        router.frozen = 0;
        router.turn += 1;
        router.held.clear();
        let pending_connections = std::mem::take(&mut router.pending_connections);
        for attempt in pending_connections {
            self.agenda.add(self.now, Event::Connect(attempt));
        }
        self.lose_router(k, true);
    }

    /// All ends of a router's links that still stand close, and connect again.
    fn lose_router(&mut self, k: usize, all: bool) {
        for node in self.nodes() {
            let stands = match node {
                Node::Vehicle(v) => self.routers.uplinks[v][k].stands,
                Node::Replica(r) => self.routers.replica_links[r].router == Some(k),
            };
            if !stands {
                continue;
            }
            if all {
                self.unlink(node, k);
                self.connect(node, k);
            } else {
                let turn = self.routers.each[k].turn;
                let due = self.now + lease(&mut self.rng);
                self.agenda.add(due, Event::Lease(node, k, turn));
            }
        }
    }

    pub(crate) fn start_router(&mut self, k: usize) {
        let router = &mut self.routers.each[k];
        if router.runs {
            return;
        }
        router.runs = true;
        router.since = self.now;
        router.turn += 1;
        self.note(&format!("router {k} listens"));
    }

    pub(crate) fn freeze_router(&mut self, k: usize) {
        let router = &mut self.routers.each[k];
        router.frozen += 1;
        if router.frozen == 1 {
            router.turn += 1;
            self.lose_router(k, false);
        }
    }

    /// The lease of a link to a frozen router has passed.
    pub(crate) fn lease_ends(&mut self, node: Node, k: usize, turn: u32) {
        if self.routers.each[k].turn != turn {
            return;
        }
        self.unlink(node, k);
        self.connect(node, k);
    }

    /// A frozen router continues: what waited in its sockets passes on.
    pub(crate) fn thaw_router(&mut self, k: usize) {
        let now = self.now;
        let router = &mut self.routers.each[k];
        router.frozen = router.frozen.saturating_sub(1);
        if router.frozen > 0 {
            return;
        }
        router.turn += 1;
        router.since = now;
        for since in self.routers.since.iter_mut().flatten() {
            *since = (*since).max(now);
        }
        let router = &mut self.routers.each[k];
        let held = std::mem::take(&mut router.held);
        let pending_connections = std::mem::take(&mut router.pending_connections);
        let mut due = now;
        for (_, _, event) in held {
            // Messages of one link do not overtake each other.
            due = due.max(now + latency(&mut self.rng));
            self.agenda.add(due, event);
        }
        for attempt in pending_connections {
            let due = now + handshake(&mut self.rng);
            self.agenda.add(due, Event::Connect(attempt));
        }
    }

    /// Adds an event that a message between a vehicle and a replica causes, after `delay` and on each of its routes; those
    /// that lead through a frozen router wait there.
    pub(crate) fn send(
        &mut self,
        (v, r): (usize, usize),
        delay: Duration,
        events: impl Iterator<Item = Event>,
    ) {
        let routes = self.routers.routes(v, r);
        for (route, event) in routes.into_iter().zip(events) {
            let hops: Duration = (0..route.hops).map(|_| latency(&mut self.rng)).sum();
            match route.frozen {
                Some(k) => self.routers.each[k].held.push((v, r, event)),
                None => self.agenda.add(self.now + delay + hops, event),
            }
        }
    }
}
