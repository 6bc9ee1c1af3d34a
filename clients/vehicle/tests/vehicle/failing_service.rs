//! A vehicle whose service stops and starts again.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use egp_service::{Server, ServiceConfig};
use egp_testing::messages;
use egp_testing::ports::free_endpoint;
use egp_vehicle::{
    GateLimits, Measurement, Mode, Outcome, Step, VehicleClient, VehicleConfig, VehicleParameters,
};
use egp_wire::proto::VehicleStatus;
use egp_wire::{Ready, keys};
use prost::Message as _;
use serde_json::Value;
use zenoh::Wait as _;

use crate::LIBRARY;

/// The limits of the car that the demo library was trained for.
fn limits() -> GateLimits {
    GateLimits::of(&VehicleParameters::FORD_ESCORT)
}

fn service(replica: &str, endpoint: &str) -> ServiceConfig {
    let mut config = ServiceConfig::new(LIBRARY);
    replica.clone_into(&mut config.replica);
    config.workers = Some(1);
    config
        .zenoh
        .insert("listen/endpoints".to_owned(), format!("[\"{endpoint}\"]"));
    config
}

fn serve(replica: &str, endpoint: &str) -> Server {
    Server::start(&service(replica, endpoint)).unwrap()
}

/// A vehicle at 12 m/s on a straight road. It does not move, because only the answers matter here.
struct Vehicle {
    client: VehicleClient,
    p_x: f64,
    u: [f64; 2],
}

impl Vehicle {
    fn connect(endpoints: &[&str]) -> Self {
        let mut config = VehicleConfig::new("test", "car", limits(), endpoints).unwrap();
        config.driver.max_tail_ticks = Some(5);
        config.publish_status = true;
        Self::of(VehicleClient::connect(&config).unwrap())
    }

    fn of(client: VehicleClient) -> Self {
        let (p_x, u) = (0.0, [0.0; 2]);
        Self { client, p_x, u }
    }

    fn step(&mut self) -> Step {
        let (dt, v_x) = (self.client.dt(), 12.0);
        let row = |t: usize| [self.p_x + v_x * dt * t as f64, 0.0, v_x, 0.0];
        let reference: Vec<_> = (0..=self.client.horizon()).map(row).collect();
        // The budget is long, so that other tests on the machine do not make answers late.
        let begun = Instant::now() + Duration::from_secs(1);
        let step = self
            .client
            .step_since(
                begun,
                [self.p_x, 0.2, v_x, 0.0, 0.0, 0.0, 0.0],
                &reference,
                &[],
            )
            .unwrap();
        self.p_x += v_x * dt;
        self.check_limits(&step);
        step
    }

    /// Checks value and slew of every command.
    fn check_limits(&mut self, step: &Step) {
        let (limits, dt, [force, rate]) = (limits(), self.client.dt(), step.command.u);
        assert!((limits.force_min..=limits.force_max).contains(&force));
        assert!(rate.abs() <= limits.steering_rate);
        assert!((force - self.u[0]).abs() <= limits.force_slew * dt * (1.0 + 1e-12));
        assert!((rate - self.u[1]).abs() <= limits.steering_slew * dt * (1.0 + 1e-12));
        self.u = step.command.u;
    }

    /// Waits until so many replicas have announced themselves, each over its link.
    fn wait_for_replicas(&mut self, count: usize) {
        let deadline = Instant::now() + Duration::from_secs(20);
        while self.client.replicas().len() != count {
            assert!(Instant::now() < deadline, "{:?}", self.client.replicas());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Steps until one has a new plan in time.
    fn step_until_solved(&mut self) -> Step {
        let deadline = Instant::now() + Duration::from_secs(20);
        loop {
            let step = self.step();
            if step.outcome.is_solved() {
                return step;
            }
            assert!(Instant::now() < deadline, "{:?}", step.outcome);
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

#[test]
fn a_lost_service_means_tail_then_stop_and_a_new_one_is_picked_up() {
    let endpoint = free_endpoint();
    let server = serve("main", &endpoint);
    let mut vehicle = Vehicle::connect(&[&endpoint]);
    assert_eq!(vehicle.step_until_solved().command.mode, Mode::Normal);
    vehicle.step_until_solved();
    drop(server);
    for tick in 0..5 {
        let step = vehicle.step();
        assert_eq!(
            step.command.mode,
            Mode::Tail,
            "tick {tick}, {:?}",
            step.outcome
        );
        assert_eq!(step.outcome, Outcome::Unreachable);
    }
    let stop = vehicle.step();
    assert_eq!(stop.command.mode, Mode::Stop);
    assert!(
        stop.command.u[0] <= vehicle.u[0] && stop.command.u[0] < 0.0,
        "it brakes"
    );
    let server = serve("main", &endpoint);
    let solved = vehicle.step_until_solved();
    assert_eq!(solved.command.mode, Mode::Stop, "a stop is latched");
    vehicle.client.reset();
    assert_eq!(vehicle.step_until_solved().command.mode, Mode::Normal);
    server.drain();
}

#[test]
fn another_replica_takes_over_without_a_missed_plan() {
    let endpoints = [free_endpoint(), free_endpoint()];
    let mut servers =
        ["a", "b"].map(|name| Some(serve(name, &endpoints[usize::from(name == "b")])));
    let mut vehicle = Vehicle::connect(&[&endpoints[0], &endpoints[1]]);
    vehicle.step_until_solved();
    vehicle.wait_for_replicas(2);
    // Whichever replica the vehicle uses, the other one answers in the next period.
    servers[0] = None;
    assert!(vehicle.step().outcome.is_solved());
    vehicle.wait_for_replicas(1);
    servers[0] = Some(serve("a", &endpoints[0]));
    vehicle.step_until_solved();
    vehicle.wait_for_replicas(2);
    servers[1] = None;
    assert!(vehicle.step().outcome.is_solved());
}

/// A session that listens at `endpoint` only.
fn listening(endpoint: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let (only, off) = (format!("[\"{endpoint}\"]"), "false");
    config.insert_json5("listen/endpoints", &only).unwrap();
    (config.insert_json5("scouting/multicast/enabled", off)).unwrap();
    zenoh::open(config).wait().unwrap()
}

#[test]
fn a_replica_that_holds_every_query_costs_no_more_than_the_deadline() {
    const DEADLINE: Duration = Duration::from_millis(60);
    let endpoint = free_endpoint();
    let session = listening(&endpoint);
    let [fleet, car, replica] = ["test", "car", "main"].map(|name| name.parse().unwrap());
    let ready = Ready {
        vehicle: Some(VehicleParameters::FORD_ESCORT),
        ..messages::ready()
    };
    let key = keys::ready(&replica);
    let _description = (session.declare_queryable(key.clone()))
        .callback(move |query| query.reply(&key, ready.encode()).wait().unwrap())
        .wait()
        .unwrap();
    let held = (session.declare_queryable(keys::step(&replica, &fleet, &car)))
        .with(zenoh::handlers::FifoChannel::new(16))
        .wait()
        .unwrap();
    let _token = (session.liveliness().declare_token(keys::live(&replica)))
        .wait()
        .unwrap();
    let mut vehicle = Vehicle::connect(&[&endpoint]);
    let dt = Duration::from_secs_f64(vehicle.client.dt());
    let measurement = Measurement {
        x: [0.0, 0.2, 12.0, 0.0, 0.0, 0.0, 0.0],
        reference: vec![[0.0, 0.0, 12.0, 0.0]; vehicle.client.horizon() + 1],
        ..Measurement::default()
    };
    // A stall of the machine prolongs one of three steps.
    let times = [(); 3].map(|()| {
        let begun = Instant::now();
        let step = (vehicle.client).step_by(begun + DEADLINE, measurement.clone());
        let took = begun.elapsed();
        assert_eq!(step.unwrap().outcome, Outcome::Late);
        took
    });
    // Measured on a busy machine: 62 to 65 ms.
    assert!(times.iter().min().unwrap() < &(DEADLINE + dt), "{times:?}");
    assert_eq!(held.len(), 3, "the queries have arrived");
}

#[test]
fn a_vehicle_publishes_its_status_at_most_ten_times_a_second() {
    let (endpoint, display) = (free_endpoint(), free_endpoint());
    let server = serve("main", &endpoint);
    let session = listening(&display);
    let published = session
        .declare_subscriber(keys::ALL_VEHICLES)
        .wait()
        .unwrap();
    let mut vehicle = Vehicle::connect(&[&endpoint, &display]);
    let mut messages = Vec::new();
    let began = Instant::now();
    let mut first = None;
    // The link to the display may open after the first steps.
    while messages.len() < 5 {
        vehicle.step_until_solved();
        while let Ok(Some(sample)) = published.try_recv() {
            assert_eq!(sample.key_expr().as_str(), "egp/v1/@vehicle/test/car");
            messages.push(VehicleStatus::decode(&*sample.payload().to_bytes()).unwrap());
            first.get_or_insert(Instant::now());
        }
        assert!(began.elapsed() < Duration::from_secs(20));
        std::thread::sleep(Duration::from_millis(10));
    }
    let elapsed = first.unwrap().elapsed();
    let most = elapsed.as_millis() / 100 + 2;
    assert!(
        messages.len() as u128 <= most,
        "{} in {elapsed:?}",
        messages.len()
    );
    let [.., before, last] = messages.as_slice() else {
        panic!("there are at least two")
    };
    assert_eq!(before.run, last.run);
    let new = last.periods - before.periods;
    assert_eq!(last.times.len() as u64, new, "every period is told once");
    assert!(last.times.iter().all(|times| times.total_ms > 0.0));
    assert_eq!(last.plan.len(), 2 * (vehicle.client.horizon() + 1));
    assert_eq!(last.members, vehicle.client.members());
    assert!((last.lateral_error - 0.2).abs() < 1e-12);
    let step = last.step.as_ref().unwrap();
    assert_eq!(
        (&*step.mode, &*step.status, &*step.replica),
        ("normal", "solved", "main")
    );
    assert_eq!(step.weights.len(), last.members.len());
    server.drain();
}

#[test]
fn connecting_to_nobody_says_where_it_looked() {
    let endpoint = free_endpoint();
    let mut config = VehicleConfig::new("test", "car", limits(), &[&endpoint]).unwrap();
    config.patience = Duration::from_millis(200);
    let Err(error) = VehicleClient::connect(&config) else {
        panic!("there is nobody")
    };
    assert!(error.to_string().contains(&endpoint), "{error}");
}

#[test]
fn a_measured_state_that_cannot_be_used_stops_and_a_wrong_reference_is_an_error() {
    let endpoint = free_endpoint();
    let server = serve("main", &endpoint);
    let mut vehicle = Vehicle::connect(&[&endpoint]);
    vehicle.step_until_solved();
    let reference = vec![[0.0; 4]; vehicle.client.horizon() + 1];
    let error = vehicle
        .client
        .step([0.0; 7], &reference[1..], &[])
        .unwrap_err();
    assert!(
        error.to_string().starts_with("reference: expected"),
        "{error}"
    );
    assert_eq!(vehicle.client.mode(), Mode::Normal);
    let mut x = [0.0; 7];
    x[2] = f64::NAN;
    let step = vehicle.client.step(x, &reference, &[]).unwrap();
    assert_eq!(step.command.mode, Mode::Stop);
    assert!(
        step.outcome.detail().contains("x: row 0: v_x"),
        "{:?}",
        step.outcome
    );
    server.drain();
}

#[test]
fn with_a_key_only_a_service_that_has_the_same_key_is_driven_with() {
    let file = |name: &str, digits: &str| {
        let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::write(&path, format!("test/car {}\n", digits.repeat(32))).unwrap();
        path
    };
    let (own, other) = (file("own.keys", "01"), file("other.keys", "02"));
    let endpoint = free_endpoint();
    let config = VehicleConfig::new("test", "car", limits(), &[&endpoint]).unwrap();
    let mut config = config.with_key(&own).unwrap();
    config.patience = Duration::from_secs(2);
    let connect = || VehicleClient::connect(&config);
    let sealed = |endpoint: &str, keys: Option<&PathBuf>| {
        let mut config = service("main", endpoint);
        config.vehicle_keys = keys.cloned();
        Server::start(&config).unwrap()
    };
    let server = sealed(&endpoint, Some(&own));
    let mut vehicle = Vehicle::of(connect().unwrap());
    vehicle.step_until_solved();
    drop(server);
    for keys in [None, Some(&other)] {
        let stranger = sealed(&endpoint, keys);
        let error = connect().err().unwrap().to_string();
        assert!(
            error.contains("does not have the tag of this vehicle's key"),
            "{error}"
        );
        for _ in 0..20 {
            assert!(!vehicle.step().outcome.is_solved());
            std::thread::sleep(Duration::from_millis(20));
        }
        drop(stranger);
    }
    let _server = sealed(&endpoint, Some(&own));
    vehicle.client.reset();
    vehicle.step_until_solved();
    // The numbers of a second connection start again from 1, in a run of its own.
    let mut second = Vehicle::of(connect().unwrap());
    assert!((0..3).any(|_| second.step().outcome.is_solved()));
}

/// The spans of a file.
fn spans(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap();
    std::fs::remove_file(path).unwrap();
    let of_line = |line| {
        let data: Value = serde_json::from_str(line).unwrap();
        let spans = &data["resourceSpans"][0]["scopeSpans"][0]["spans"];
        spans.as_array().unwrap().clone()
    };
    text.lines().flat_map(of_line).collect()
}

#[test]
fn client_and_service_write_spans_of_the_same_traces() {
    let (endpoint, folder) = (free_endpoint(), Path::new(env!("CARGO_TARGET_TMPDIR")));
    let [ours, theirs] = ["car.jsonl", "server.jsonl"].map(|name| folder.join(name));
    let mut config = service("main", &endpoint);
    config.traces = Some(theirs.clone());
    let server = Server::start(&config).unwrap();
    let mut config = VehicleConfig::new("test", "car", limits(), &[&endpoint]).unwrap();
    config.traces = Some(folder.join("missing/car.jsonl"));
    let refused = VehicleClient::connect(&config)
        .err()
        .map(|error| error.to_string());
    assert!(refused.is_some_and(|message| message.contains("cannot write traces")));
    config.traces = Some(ours.clone());
    let mut vehicle = Vehicle::of(VehicleClient::connect(&config).unwrap());
    for _ in 0..3 {
        vehicle.step_until_solved();
    }
    drop((vehicle, server));
    let (ours, theirs) = (spans(&ours), spans(&theirs));
    let steps: Vec<_> = (ours.iter())
        .filter(|span| span["name"] == "egp.step")
        .collect();
    assert!(steps.len() >= 3);
    let newest = steps.last().unwrap();
    let same = |span: &&Value| span["traceId"] == newest["traceId"];
    let asked: Vec<_> = (ours.iter().filter(same))
        .filter(|span| span["name"] == "egp.ask")
        .collect();
    let answered: Vec<_> = (theirs.iter().filter(same))
        .filter(|span| span["name"] == "egp.request")
        .collect();
    assert_eq!((asked.len(), answered.len()), (1, 1));
    assert_eq!(asked[0]["parentSpanId"], newest["spanId"]);
    assert_eq!(answered[0]["parentSpanId"], asked[0]["spanId"]);
}
