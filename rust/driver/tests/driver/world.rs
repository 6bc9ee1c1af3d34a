//! A driver with replicas that the test plays.

use std::time::Duration;

use egp_driver::{Action, Driver, DriverConfig, Measurement, Query, Step};
use egp_gate::Limits as GateLimits;
use egp_parameters::VehicleParameters;
use egp_wire::keys::Name;
use egp_wire::{Code, Predictions, Ready, Reply, Request, Status, WireError};

pub(crate) const CAR: VehicleParameters = VehicleParameters::FORD_ESCORT;
pub(crate) const HORIZON: u32 = 4;
/// A control period, and the time that an answer may take in it.
pub(crate) const PERIOD: Duration = Duration::from_millis(20);
pub(crate) const BUDGET: Duration = Duration::from_millis(16);
/// How long a query listens beyond its deadline.
pub(crate) const LISTEN: Duration = Duration::from_millis(400);

/// What the replicas serve.
pub(crate) fn served() -> Ready {
    Ready {
        ready: true,
        library: [7; 32],
        others: Vec::new(),
        dt: PERIOD.as_secs_f64(),
        horizon: HORIZON,
        history: 3,
        members: vec!["dry".to_owned(), "wet".to_owned()],
        envelope: [
            [0.0, -5.0, -2.0, -0.6, -9e3, -0.4],
            [30.0, 5.0, 2.0, 0.6, 9e3, 0.4],
        ],
        vehicle: Some(CAR),
        sealed: false,
    }
}

pub(crate) fn config() -> DriverConfig {
    DriverConfig::new("depot", "car-7", GateLimits::of(&CAR)).unwrap()
}

pub(crate) fn name(text: &str) -> Name {
    text.parse().unwrap()
}

pub(crate) fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// A driver with these replicas.
pub(crate) fn driver(replicas: &[&str]) -> Driver {
    configured(replicas, config())
}

/// The same, which never asks a second replica while it waits for the first one.
pub(crate) fn without_hedge(replicas: &[&str]) -> Driver {
    let hedge = 1.0;
    configured(replicas, DriverConfig { hedge, ..config() })
}

pub(crate) fn configured(replicas: &[&str], config: DriverConfig) -> Driver {
    let mut driver = Driver::new(config, served()).unwrap();
    for replica in replicas {
        appear(&mut driver, &name(replica));
    }
    driver
}

/// A replica announces itself that is known to fit the vehicle.
pub(crate) fn appear(driver: &mut Driver, replica: &Name) {
    driver.replica_appeared(replica.clone());
    driver.replica_fits(replica);
}

/// A vehicle at 12 m/s on a straight road that begins at its position.
pub(crate) fn measurement() -> Measurement {
    let row = |t: u32| [3.0 + 0.24 * f64::from(t), 4.0, 12.0, 0.0];
    Measurement {
        x: [3.0, 4.0, 12.0, 0.0, 0.0, 0.0, 0.0],
        reference: (0..=HORIZON).map(row).collect(),
        ..Measurement::default()
    }
}

/// Opens a period that begins `now`.
pub(crate) fn tick(driver: &mut Driver, now: Duration) {
    driver.tick(now, now + BUDGET, measurement()).unwrap();
}

/// The question that comes next.
pub(crate) fn asked(driver: &mut Driver) -> Query {
    match driver.next_action() {
        Some(Action::Ask(query)) => query,
        other => panic!("expected a question, got {other:?}"),
    }
}

/// The probe that comes next.
pub(crate) fn probed(driver: &mut Driver) -> Query {
    match driver.next_action() {
        Some(Action::Probe(query)) => query,
        other => panic!("expected a probe, got {other:?}"),
    }
}

/// The decided period, after which there is nothing to do.
pub(crate) fn decided(driver: &mut Driver) -> Step {
    match driver.next_action() {
        Some(Action::Command(step)) => {
            assert!(driver.next_action().is_none());
            *step
        }
        other => panic!("expected a command, got {other:?}"),
    }
}

pub(crate) fn request(query: &Query) -> Request {
    Request::decode(&query.payload).unwrap()
}

/// What a sound replica replies: a plan that drives with 100 N.
pub(crate) fn solved(query: &Query) -> Reply {
    let request = request(query);
    let rows = 2 * request.history_z.len();
    Reply {
        library: request.library,
        sequence: request.sequence,
        status: Status::Solved,
        plan_x: vec![request.x; HORIZON as usize + 1],
        plan_u: vec![[100.0, 0.0]; HORIZON as usize],
        weights: vec![0.25, 0.75],
        history_f: Predictions::new(2, vec![[0.5; 3]; rows]),
        ..Reply::default()
    }
}

/// The reply of a solver that found no plan.
pub(crate) fn infeasible(query: &Query) -> Reply {
    Reply {
        status: Status::Infeasible,
        plan_x: vec![],
        plan_u: vec![],
        ..solved(query)
    }
}

pub(crate) fn error(code: Code) -> Vec<u8> {
    WireError::permanent(code, "no").encode()
}

/// One period that begins `now` and is answered at once by the replica that is asked first. Returns its name.
pub(crate) fn answered_period(driver: &mut Driver, now: Duration) -> Name {
    tick(driver, now);
    let query = asked(driver);
    driver.replied(now, query.id, &solved(&query).encode(), b"");
    assert!(decided(driver).outcome.is_solved());
    query.replica
}
