//! Vehicles that exchange what they measured through a real map service.

use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use egp_parameters::friction_hypotheses;
use egp_service::map::{MapConfig, MapServer};
use egp_testing::ports::free_endpoint;
use egp_vehicle::{FleetMap, FleetMapConfig, FleetMapError, FleetNotice, RoadBelief};
use egp_wire::{RoadTiles, encode_tiles_changed};
use zenoh::Wait as _;

const ROAD: f64 = 300.0;
/// More publications than a vehicle keeps.
const FLOOD: usize = 200;

fn serve(endpoint: &str) -> MapServer {
    let mut config = MapConfig {
        publish_ms: 10,
        ..MapConfig::default()
    };
    let listen = format!("[\"{endpoint}\"]");
    config.zenoh.insert("listen/endpoints".to_owned(), listen);
    MapServer::start(&config).unwrap()
}

/// A vehicle that takes part in the map.
struct Car {
    belief: RoadBelief,
    fleet: FleetMap,
}

impl Car {
    fn connect(name: &str, endpoint: &str) -> Self {
        let mut belief = RoadBelief::new(ROAD, true).unwrap();
        let mut config = FleetMapConfig::new("depot", name, "ring", &[endpoint]).unwrap();
        config.settings.timeout = Duration::from_secs(20); // on a busy machine
        let fleet = FleetMap::connect(&config, &mut belief).unwrap();
        Self { belief, fleet }
    }

    fn fetch(&mut self) -> bool {
        self.fleet.fetch(&mut self.belief)
    }

    /// Measures this friction along a stretch of the road.
    fn measure(&mut self, friction: f64, from: f64, to: f64) {
        let evidence = friction_hypotheses().map(|h| -0.5 * ((h / friction).ln() / 0.1).powi(2));
        let most = evidence.iter().copied().fold(f64::MIN, f64::max);
        let evidence = evidence.map(|value| value - most);
        self.belief.leave();
        let mut s = from;
        while s < to {
            self.belief.update(s, Some(&evidence)).unwrap();
            s += 0.2;
        }
    }

    fn median(&mut self, s: f64) -> f64 {
        self.belief.quantile(s, 0.5).unwrap()
    }

    fn origins(&self) -> Vec<String> {
        let origins = self.fleet.origins();
        origins.keys().map(ToString::to_string).collect()
    }

    /// Drives until something is so.
    fn drive_until(&mut self, holds: impl Fn(&mut Self) -> bool) {
        let late = Instant::now() + Duration::from_secs(30);
        while !holds(self) {
            assert!(Instant::now() < late);
            self.fleet.exchange(&mut self.belief);
            sleep(Duration::from_millis(5));
        }
    }
}

#[test]
fn a_vehicle_plans_with_what_another_one_measured_before_and_meanwhile() {
    let endpoint = free_endpoint();
    let server = serve(&endpoint);
    let mut first = Car::connect("first", &endpoint);
    assert!(first.fetch() && first.fleet.answered());
    assert!(first.origins().is_empty());
    first.measure(0.4, 0.0, 100.0);
    assert_eq!(first.fleet.finish(&mut first.belief), 0);

    let mut second = Car::connect("second", &endpoint);
    let before = second.median(50.0);
    assert!(second.fetch());
    assert_eq!(second.origins(), ["first"]);
    assert!((second.median(50.0) - 0.4).abs() < 0.05);
    assert!((before - 0.4).abs() > 0.05);

    // What the first one measures while the second one drives reaches it, too.
    assert!((second.median(225.0) - 0.9).abs() > 0.1);
    first.measure(0.9, 200.0, 250.0);
    first.drive_until(|car| car.fleet.finish(&mut car.belief) == 0);
    second.drive_until(|car| (car.median(225.0) - 0.9).abs() < 0.1);
    assert_eq!(second.fleet.next_notice(), None);
    server.stop().unwrap();
}

#[test]
fn evidence_waits_for_a_service_that_starts_later() {
    let endpoint = free_endpoint();
    let mut belief = RoadBelief::new(ROAD, true).unwrap();
    let mut config = FleetMapConfig::new("depot", "car", "ring", &[&endpoint]).unwrap();
    config.settings.timeout = Duration::from_millis(300);
    let fleet = FleetMap::connect(&config, &mut belief).unwrap();
    let mut car = Car { belief, fleet };
    let begun = Instant::now();
    assert!(!car.fetch() && car.fleet.silent() && !car.fleet.answered());
    assert!(begun.elapsed() < Duration::from_secs(5));
    assert_eq!(car.fleet.next_notice(), Some(FleetNotice::NoAnswer));
    car.measure(0.4, 0.0, 100.0);
    assert_eq!(car.fleet.finish(&mut car.belief), 1);
    assert_eq!(car.fleet.next_notice(), Some(FleetNotice::Unsent(1)));

    let server = serve(&endpoint);
    car.drive_until(|car| car.fleet.answered() && !car.fleet.silent());
    car.drive_until(|car| car.fleet.finish(&mut car.belief) == 0);
    let mut other = Car::connect("other", &endpoint);
    assert!(other.fetch());
    assert_eq!(other.origins(), ["car"]);
    server.stop().unwrap();
}

#[test]
fn after_more_publications_than_are_kept_all_tiles_are_asked_for() {
    let endpoint = free_endpoint();
    let mut hub = zenoh::Config::default();
    for (key, value) in [
        ("listen/endpoints", format!("[\"{endpoint}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        hub.insert_json5(key, &value).unwrap();
    }
    let hub = zenoh::open(hub).wait().unwrap();
    let asked = Arc::new(Mutex::new(Vec::new()));
    let seen = asked.clone();
    let service = hub
        .declare_queryable("egp/v1/map/depot/car/ring/tiles/*")
        .callback(move |query| {
            let key = query.key_expr().as_str();
            seen.lock()
                .unwrap()
                .push(key.rsplit('/').next().unwrap().to_owned());
            let nothing = RoadTiles::default().encode();
            query.reply(key, nothing).wait().unwrap();
        })
        .wait()
        .unwrap();
    let mut car = Car::connect("car", &endpoint);
    let publish = || {
        let changed = encode_tiles_changed(vec![2]);
        (hub.put("egp/v1/@map/depot/ring", changed).wait()).unwrap();
    };
    car.drive_until(|_| {
        publish();
        !asked.lock().unwrap().is_empty()
    });
    assert_eq!(asked.lock().unwrap()[0], "2");
    asked.lock().unwrap().clear();
    for _ in 0..FLOOD {
        publish();
    }
    sleep(Duration::from_millis(500)); // until they have arrived
    car.drive_until(|_| !asked.lock().unwrap().is_empty());
    assert_eq!(asked.lock().unwrap()[0], "0");
    service.undeclare().wait().unwrap();
}

#[test]
fn settings_out_of_range_and_endpoints_that_are_none_are_errors() {
    let mut belief = RoadBelief::new(ROAD, true).unwrap();
    let mut config = FleetMapConfig::new("depot", "car", "ring", &["nowhere"]).unwrap();
    let error = FleetMap::connect(&config, &mut belief).err().unwrap();
    assert!(matches!(error, FleetMapError::Network(_)), "{error}");
    config.settings.lifetime = f64::NAN;
    let error = FleetMap::connect(&config, &mut belief).err().unwrap();
    assert!(matches!(error, FleetMapError::Settings(_)), "{error}");
    assert!(FleetMapConfig::new("depot", "a/b", "ring", &[]).is_err());
}
