//! Vehicles of a fleet and a map service in virtual time: messages are lost, late or doubled, links are cut, and the service is
//! overloaded, absent, or started again without what it had. Once the faults have ended, every vehicle has all evidence of the others.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use egp_driver::{FleetAction, FleetExchange, FleetSettings, MapQuery, QueryId};
use egp_map::{MergeSettings, RoadBelief, Tile, merge};
use egp_parameters::friction_hypotheses;
use egp_service::map::{MapLimits, Store};
use egp_wire::road_keys::{self, RoadKey, RoadTarget};
use egp_wire::{Code, RoadTile, RoadTiles, TileEvidence, WireError, encode_tiles_changed};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const CARS: usize = 3;
/// Length of the road, m, of five tiles.
const ROAD: f64 = 640.0;
const PERIOD: Duration = Duration::from_millis(20);
/// The faults end.
const HEALED: Duration = Duration::from_secs(40);
const END: Duration = Duration::from_secs(70);
/// No cut of a link or absence of the service is shorter. A vehicle that measures something sends it every second, and so notices it.
const SHORTEST: f64 = 1.2;

/// Ageing without a limit of the likelihoods.
const AGEING: MergeSettings = MergeSettings {
    capacity: 8.0,
    lifetime: 1800.0,
};

/// What arrives somewhere, later.
enum Arrival {
    AtService(usize, MapQuery),
    AtCar(usize, QueryId, Result<Vec<u8>, Vec<u8>>),
    Ended(usize, QueryId),
    Published(usize, Vec<u8>),
}

struct Car {
    key: RoadKey,
    belief: RoadBelief,
    exchange: FleetExchange,
    s: f64,
    friction: f64,
    open: BTreeMap<QueryId, String>,
    /// The newest answer about each tile.
    told: BTreeMap<u32, (Tile, Duration)>,
    /// Until when the link is cut.
    cut: Duration,
}

struct World {
    now: Duration,
    random: ChaCha8Rng,
    cars: Vec<Car>,
    store: Store,
    absent: Duration,
    arrivals: BTreeMap<(Duration, u64), Arrival>,
    sent: u64,
    /// How often something of each kind happened.
    seen: BTreeMap<&'static str, usize>,
}

fn store() -> Store {
    let limits = MapLimits {
        contributions: 1000,
        vehicles: 16,
        tiles: 100,
        roads: 4,
    };
    Store::new(MergeSettings::default(), limits)
}

impl Car {
    fn new(number: usize) -> Self {
        let key = RoadKey {
            fleet: "depot".parse().unwrap(),
            vehicle: format!("car-{number}").parse().unwrap(),
            road: "ring".parse().unwrap(),
        };
        let mut belief = RoadBelief::new(ROAD, true).unwrap();
        let settings = FleetSettings::default();
        let exchange =
            FleetExchange::new(key.clone(), settings, Duration::ZERO, &mut belief).unwrap();
        Self {
            key,
            belief,
            exchange,
            s: 0.31 * ROAD * number as f64,
            friction: 0.3 + 0.2 * number as f64,
            open: BTreeMap::new(),
            told: BTreeMap::new(),
            cut: Duration::ZERO,
        }
    }

    /// Measures a friction of its own at 8 m/s, along half of the road before the faults end.
    fn drive(&mut self) {
        let evidence =
            friction_hypotheses().map(|h| -0.5 * ((h / self.friction).ln() / 0.1).powi(2));
        let most = evidence.iter().copied().fold(f64::MIN, f64::max);
        let evidence = evidence.map(|value| value - most);
        self.belief.update(self.s, Some(&evidence)).unwrap();
        self.s = (self.s + 8.0 * PERIOD.as_secs_f64()) % ROAD;
    }
}

impl World {
    fn new(seed: u64) -> Self {
        Self {
            now: Duration::ZERO,
            random: ChaCha8Rng::seed_from_u64(seed),
            cars: (0..CARS).map(Car::new).collect(),
            store: store(),
            absent: Duration::ZERO,
            arrivals: BTreeMap::new(),
            sent: 0,
            seen: BTreeMap::new(),
        }
    }

    /// Whether a fault of this probability happens now.
    fn fault(&mut self, kind: &'static str, probability: f64) -> bool {
        let happens = self.now < HEALED && self.random.random_bool(probability);
        if happens {
            *self.seen.entry(kind).or_default() += 1;
        }
        happens
    }

    fn send(&mut self, after: Duration, arrival: Arrival) {
        self.sent += 1;
        self.arrivals.insert((self.now + after, self.sent), arrival);
    }

    /// How long a message takes.
    fn delay(&mut self) -> Duration {
        let late = self.fault("late", 0.1);
        Duration::from_millis(self.random.random_range(1..if late { 2500 } else { 30 }))
    }

    fn run(&mut self) {
        for car in &mut self.cars {
            car.exchange.fetch(Duration::ZERO);
        }
        while self.now < END {
            self.break_something();
            while let Some(next) = self.arrivals.first_entry()
                && next.key().0 <= self.now
            {
                let arrival = next.remove();
                self.arrive(arrival);
            }
            for number in 0..CARS {
                let (now, car) = (self.now, &mut self.cars[number]);
                if now < HEALED {
                    car.drive();
                }
                if car.exchange.is_waiting() {
                    car.exchange.wake(now, &mut car.belief);
                } else {
                    car.exchange.period(now, &mut car.belief);
                }
                self.carry_out(number);
            }
            self.now += PERIOD;
        }
    }

    /// Cuts links. What is under way on them is lost, too.
    fn break_something(&mut self) {
        let absent = self.fault("absent", 0.001);
        if absent {
            self.absent = HEALED.min(self.now + self.long());
            self.store = store();
        }
        for number in 0..CARS {
            let cut = self.fault("cut", 0.001);
            if cut {
                self.cars[number].cut = HEALED.min(self.now + self.long());
            }
            if cut || absent {
                self.arrivals.retain(|_, arrival| match arrival {
                    Arrival::AtService(to, _)
                    | Arrival::AtCar(to, ..)
                    | Arrival::Published(to, _) => *to != number,
                    Arrival::Ended(..) => true,
                });
            }
        }
    }

    fn long(&mut self) -> Duration {
        Duration::from_secs_f64(self.random.random_range(SHORTEST..8.0))
    }

    fn cut(&self, number: usize) -> bool {
        self.now < self.absent || self.now < self.cars[number].cut
    }

    fn carry_out(&mut self, number: usize) {
        while let Some(action) = self.cars[number].exchange.next_action() {
            let FleetAction::Ask(query) = action else {
                continue;
            };
            let (id, listen) = (query.id, query.listen);
            let open = &mut self.cars[number].open;
            assert!(
                !open.values().any(|key| *key == query.key),
                "{} is asked twice",
                query.key
            );
            open.insert(id, query.key.clone());
            assert!(open.len() <= 17, "{open:?}");
            self.send(listen, Arrival::Ended(number, id));
            if !self.cut(number) && !self.fault("request lost", 0.1) {
                let delay = self.delay();
                self.send(delay, Arrival::AtService(number, query));
            }
        }
    }

    fn arrive(&mut self, arrival: Arrival) {
        let now = self.now;
        match arrival {
            Arrival::AtService(number, query) if !self.cut(number) => {
                let id = query.id;
                let answer = self.serve(number, query);
                let copies = if self.fault("doubled", 0.1) { 2 } else { 1 };
                for _ in 0..copies {
                    let delay = self.delay();
                    self.send(delay, Arrival::AtCar(number, id, answer.clone()));
                }
            }
            Arrival::AtCar(number, id, answer)
                if !self.cut(number) && !self.fault("reply lost", 0.1) =>
            {
                let car = &mut self.cars[number];
                match answer {
                    Ok(answer) => {
                        if car.open.get(&id).is_some_and(|key| key.contains("/tiles/")) {
                            let tiles = RoadTiles::decode(&answer).unwrap().tiles;
                            let tile = |tile: RoadTile| {
                                (tile.index, (Tile::from_bytes(&tile.rows).unwrap(), now))
                            };
                            car.told.extend(tiles.into_iter().map(tile));
                        }
                        car.exchange.replied(now, id, &answer, &mut car.belief);
                    }
                    Err(error) => car.exchange.refused(id, &error),
                }
                // Another copy may come after the end.
                self.end(number, id);
            }
            Arrival::Published(number, tiles) if !self.cut(number) => {
                self.cars[number].exchange.changed(&tiles);
            }
            Arrival::Ended(number, id) => self.end(number, id),
            _ => {}
        }
    }

    fn end(&mut self, number: usize, id: QueryId) {
        let car = &mut self.cars[number];
        if car.open.remove(&id).is_some() {
            car.exchange.ended(self.now, id, &mut car.belief);
            self.carry_out(number);
        }
    }

    fn serve(&mut self, number: usize, query: MapQuery) -> Result<Vec<u8>, Vec<u8>> {
        if self.fault("overloaded", 0.1) {
            return Err(WireError::retryable(Code::Overloaded, 0, "busy").encode());
        }
        let now = self.now.as_secs_f64();
        match road_keys::parse(&query.key).unwrap() {
            RoadTarget::Tiles(key, first) => {
                assert_eq!(key, self.cars[number].key);
                Ok(self.store.tiles(&key, first, now).encode())
            }
            RoadTarget::Tile(key, index) => {
                assert_eq!(key, self.cars[number].key);
                let evidence = TileEvidence::decode(&query.payload.unwrap()).unwrap();
                let at = now - 1e-3 * f64::from(evidence.age_ms);
                let tile = Tile::from_bytes(&evidence.rows).unwrap();
                self.store.add(&key, index, tile, at, now).unwrap();
                for other in 0..CARS {
                    let delay = self.delay();
                    self.send(
                        delay,
                        Arrival::Published(other, encode_tiles_changed(vec![index])),
                    );
                }
                Ok(Vec::new())
            }
            other => panic!("{other:?}"),
        }
    }

    fn check(&mut self, seed: u64) {
        let now = self.now;
        for car in &mut self.cars {
            let name = car.key.vehicle.clone();
            assert!(
                !car.exchange.silent() && car.exchange.answered(),
                "{seed} {name}"
            );
            assert_eq!(
                car.exchange.unsent(now, &mut car.belief),
                0,
                "{seed} {name}"
            );
            assert!(car.open.is_empty(), "{seed} {name}: {:?}", car.open);
            let others: BTreeSet<_> = (0..CARS).map(|number| format!("car-{number}")).collect();
            let known = car
                .exchange
                .origins(now)
                .into_keys()
                .map(|key| key.to_string());
            let known: BTreeSet<String> = known.collect();
            let mut expected = others;
            expected.remove(&name.to_string());
            assert_eq!(known, expected, "{seed} {name}");
            // What the service would answer now is what the vehicle was told last, but for its age.
            let answer = self.store.tiles(&car.key, 0, now.as_secs_f64());
            let indices: Vec<u32> = answer.tiles.iter().map(|tile| tile.index).collect();
            assert_eq!(indices, [0, 1, 2, 3, 4], "{seed} {name}");
            for tile in answer.tiles {
                let (told, at) = &car.told[&tile.index];
                let aged = merge([(told, now.saturating_sub(*at).as_secs_f64())], &AGEING);
                let pairs = aged.bytes().iter().zip(&tile.rows);
                let most = pairs.map(|(a, b)| a.abs_diff(*b)).max();
                assert!(
                    most < Some(8),
                    "{seed} {name}, tile {}: {most:?}",
                    tile.index
                );
            }
        }
    }
}

#[test]
fn every_vehicle_has_all_evidence_once_the_faults_have_ended() {
    let mut seen = BTreeMap::<&str, usize>::new();
    for seed in 0..100 {
        let mut world = World::new(seed);
        world.run();
        world.check(seed);
        for (kind, count) in &world.seen {
            *seen.entry(*kind).or_default() += count;
        }
    }
    let kinds = [
        "absent",
        "cut",
        "doubled",
        "late",
        "overloaded",
        "reply lost",
        "request lost",
    ];
    assert_eq!(seen.keys().copied().collect::<Vec<_>>(), kinds);
    assert!(seen.values().all(|count| *count > 100), "{seen:?}");
}

#[test]
fn a_seed_gives_the_same_run() {
    let messages = |seed| {
        let mut world = World::new(seed);
        world.run();
        let car = &world.cars[0];
        (
            world.sent,
            world.seen,
            car.belief.to_bytes().unwrap(),
            car.told.clone(),
        )
    };
    assert_eq!(messages(3), messages(3));
    assert_ne!(messages(3).0, messages(4).0);
}
