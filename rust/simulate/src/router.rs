//! Routers: who is linked to which, and on which routes messages pass.
//!
//! Vehicles hold a link to each router, as peers of zenoh. A replica holds one, as a client of zenoh, to the first router
//! that answers. Running routers are linked to each other. Measured with two routers: a question passes on each route, so
//! that a replica which two routes lead to gets it twice.

use std::time::Duration;

use egp_driver::QueryId;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::event::Event;

/// Time between attempts to connect: 50 ms at first, then twice as long, up to 200 ms.
const FIRST_RETRY: Duration = Duration::from_millis(50);
const LAST_RETRY: Duration = Duration::from_millis(200);

/// A vehicle or a replica.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Node {
    Vehicle(usize),
    Replica(usize),
}

/// An end of a link to a router, with its attempt to connect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Attempt {
    pub(crate) node: Node,
    /// Vehicles have a link to this router; replicas take the first that answers.
    pub(crate) router: usize,
    /// Attempts of an earlier process or link are void.
    pub(crate) epoch: u32,
    pub(crate) number: u32,
}

impl Attempt {
    /// The wait before the next attempt.
    pub(crate) fn wait(self) -> Duration {
        (FIRST_RETRY * 2_u32.pow(self.number.min(8))).min(LAST_RETRY)
    }

    pub(crate) fn next(self) -> Self {
        Self {
            number: self.number + 1,
            ..self
        }
    }
}

/// A router's process.
#[derive(Default)]
pub(crate) struct Router {
    pub(crate) runs: bool,
    pub(crate) frozen: u32,
    /// When it began to listen, or to continue after a freeze.
    pub(crate) since: Duration,
    /// Counts the starts and the freezes, so that a lease that begins with one is recognised.
    pub(crate) turn: u32,
    /// What waits in the sockets of a frozen router, with the vehicle and the replica between which it passes.
    pub(crate) held: Vec<(usize, usize, Event)>,
    /// Attempts to connect that wait for a frozen router.
    pub(crate) pending_connections: Vec<Attempt>,
}

/// One vehicle's link to one router.
#[derive(Clone, Copy, Default)]
pub(crate) struct Uplink {
    pub(crate) stands: bool,
    pub(crate) epoch: u32,
}

/// One replica's link to a router.
#[derive(Clone, Copy, Default)]
pub(crate) struct ReplicaLink {
    pub(crate) router: Option<usize>,
    pub(crate) epoch: u32,
}

/// The links of a question through routers, on which its answers return: the vehicle's router, and the epochs of its link to
/// the vehicle and of the replica's link. A link that was made again is another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Way {
    router: usize,
    epochs: [u32; 2],
}

/// A way of a message through routers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Route {
    /// Its links; none without routers.
    pub(crate) way: Option<Way>,
    /// Routers on the way.
    pub(crate) hops: u32,
    /// A frozen router on the way, in which messages wait.
    pub(crate) frozen: Option<usize>,
}

/// All routers and the links to them; without routers every vehicle has a link to every replica.
pub(crate) struct Routers {
    pub(crate) each: Vec<Router>,
    /// By vehicle and router.
    pub(crate) uplinks: Vec<Vec<Uplink>>,
    /// By replica.
    pub(crate) replica_links: Vec<ReplicaLink>,
    /// By vehicle and replica: since when a route leads from one to the other.
    pub(crate) since: Vec<Vec<Duration>>,
}

impl Routers {
    pub(crate) fn new(routers: usize, vehicles: usize, replicas: usize) -> Self {
        let router = || Router {
            runs: true,
            ..Router::default()
        };
        Self {
            each: (0..routers).map(|_| router()).collect(),
            uplinks: vec![vec![Uplink::default(); routers]; vehicles],
            replica_links: vec![ReplicaLink::default(); replicas],
            since: vec![vec![Duration::ZERO; replicas]; vehicles],
        }
    }

    /// Whether there are no routers.
    pub(crate) fn direct(&self) -> bool {
        self.each.is_empty()
    }

    /// The routes between a vehicle and a replica; one without a hop if there are no routers.
    pub(crate) fn routes(&self, v: usize, r: usize) -> Vec<Route> {
        if self.direct() {
            return vec![Route {
                way: None,
                hops: 0,
                frozen: None,
            }];
        }
        let link = self.replica_links[r];
        let Some(home) = link.router else {
            return Vec::new();
        };
        let uplinks = self.uplinks[v].iter().enumerate();
        let stands = uplinks.filter(|(_, uplink)| uplink.stands);
        let route = |(k, uplink): (usize, &Uplink)| Route {
            way: Some(Way {
                router: k,
                epochs: [uplink.epoch, link.epoch],
            }),
            hops: if k == home { 1 } else { 2 },
            frozen: [k, home].into_iter().find(|&k| self.each[k].frozen > 0),
        };
        stands.map(route).collect()
    }

    /// The frozen router in which an answer to a vehicle's query waits, if there is one.
    pub(crate) fn holder(&self, v: usize, query: QueryId) -> Option<usize> {
        let answers = |event: &Event| match event {
            Event::Deliver(asker, id, _) => (*asker, *id) == (v, query),
            _ => false,
        };
        let holds = |router: &Router| router.held.iter().any(|(.., event)| answers(event));
        self.each.iter().position(holds)
    }

    /// Whether messages pass between a vehicle and a replica without waiting.
    pub(crate) fn open(&self, v: usize, r: usize) -> bool {
        let mut routes = self.routes(v, r).into_iter();
        routes.any(|route| route.frozen.is_none())
    }

    /// Since when each router is sound; none for one that does not run or stands still.
    pub(crate) fn sound(&self) -> impl Iterator<Item = Option<Duration>> {
        let sound = |router: &Router| (router.runs && router.frozen == 0).then_some(router.since);
        self.each.iter().map(sound)
    }

    /// The router that answers a replica first, in the order of its configuration; a frozen one accepts the connection and
    /// does not answer.
    pub(crate) fn first(&self) -> Option<usize> {
        self.each.iter().position(|router| router.runs)
    }
}

/// The time from a connection to the exchange of announcements.
pub(crate) fn handshake(rng: &mut ChaCha8Rng) -> Duration {
    Duration::from_micros(rng.random_range(1000..30_000))
}
