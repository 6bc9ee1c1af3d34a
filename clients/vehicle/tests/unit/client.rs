//! Events that come while the program does something else.
#![allow(clippy::unwrap_used, clippy::panic)]

use egp_driver::QueryId;
use egp_gate::Limits;
use egp_parameters::VehicleParameters;
use egp_wire::{Ready, Reply, Request, Status};

use serde_json::Value;

use super::*;
use crate::network::report;

/// A client of a service that nobody has started.
fn client() -> VehicleClient {
    let limits = Limits::of(&VehicleParameters::FORD_ESCORT);
    let config = VehicleConfig::new("test", "car", limits, &[]).unwrap();
    let ready = Ready {
        vehicle: None,
        ..egp_testing::messages::ready()
    };
    VehicleClient {
        network: Network::open(&config).unwrap(),
        driver: Driver::new(config.driver, ready).unwrap(),
        epoch: Instant::now(),
        status: None,
        traces: None,
    }
}

fn measurement(client: &VehicleClient) -> Measurement {
    Measurement {
        x: [0.0, 0.0, 12.0, 0.0, 0.0, 0.0, 0.0],
        reference: vec![[0.0; 4]; client.horizon() + 1],
        ..Measurement::default()
    }
}

#[test]
fn events_beyond_the_deadline_wait_for_the_next_step() {
    let mut client = client();
    let now = Instant::now();
    for (deadline, left) in [(now, 1000 - FEW), (now + Duration::from_secs(60), 0)] {
        for id in 0..1000 {
            report(&client.network.sender, EventKind::Ended(QueryId(id)));
        }
        let measurement = measurement(&client);
        client.step_by(deadline, measurement).unwrap();
        let waiting = std::iter::from_fn(|| client.network.next(Duration::ZERO));
        assert_eq!(waiting.count(), left);
    }
}

#[test]
fn questions_of_a_period_that_was_given_up_have_no_spans() {
    let path = std::env::temp_dir().join(format!("egp-abandoned-{}", std::process::id()));
    let mut client = client();
    let [fleet, car] = ["test", "car"].map(|name| name.parse().unwrap());
    client.traces = Some(StepTraces::open(&path, 1.0, &fleet, &car).unwrap());
    let replica: Name = "a".parse().unwrap();
    client.driver.replica_appeared(replica.clone());
    client.driver.replica_fits(&replica);
    let (now, measurement) = (client.epoch.elapsed(), measurement(&client));
    let deadline = now + Duration::from_secs(60);
    client
        .driver
        .tick(now, deadline, measurement.clone())
        .unwrap();
    let Some(Action::Ask(query)) = client.driver.next_action() else {
        panic!("the replica is asked");
    };
    client.traces.as_mut().unwrap().asked(now, &query);
    client.reset();
    client.driver.replica_gone(now, &replica);
    client.step_by(Instant::now(), measurement).unwrap();
    drop(client);
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    let data: Value = serde_json::from_str(&text).unwrap();
    let spans = data["resourceSpans"][0]["scopeSpans"][0]["spans"].as_array();
    let names = spans.unwrap().iter().map(|span| &span["name"]);
    assert_eq!(names.collect::<Vec<_>>(), ["egp.step"]);
}

#[test]
fn a_program_that_is_held_up_after_an_answer_has_come_does_not_drive_its_plan() {
    for (ago, held_up) in [(0, false), (10, true)] {
        let mut client = client();
        let replica: Name = "a".parse().unwrap();
        client.driver.replica_appeared(replica.clone());
        client.driver.replica_fits(&replica);
        // The period began, and was answered, so many seconds ago.
        let ago = Duration::from_secs(ago);
        client.epoch = Instant::now().checked_sub(ago).unwrap();
        let (begun, measurement) = (Duration::from_millis(1), measurement(&client));
        let deadline = begun + client.driver.budget();
        client.driver.tick(begun, deadline, measurement).unwrap();
        let Some(Action::Ask(query)) = client.driver.next_action() else {
            panic!("the replica is asked");
        };
        let request = Request::decode(&query.payload).unwrap();
        let reply = Reply {
            library: request.library,
            sequence: request.sequence,
            status: Status::Solved,
            plan_x: vec![request.x; client.horizon() + 1],
            plan_u: vec![[0.0; 2]; client.horizon()],
            weights: vec![0.5; 2],
            ..Reply::default()
        };
        client.tell(Event {
            at: client.epoch + begun,
            kind: EventKind::Replied(query.id, reply.encode(), Vec::new()),
        });
        let Some(Action::Command(step)) = client.driver.next_action() else {
            panic!("the period is decided");
        };
        assert!(step.outcome.is_solved());
        assert_eq!(step.held_up > 0, held_up);
        let mode = if held_up { Mode::Waiting } else { Mode::Normal };
        assert_eq!(step.command.mode, mode);
    }
}
