//! A driver whose answers are computed in the vehicle's own process.

use std::time::Duration;

use egp_driver::{Driver, InProcessDriver, Outcome, Query, QueryId};
use egp_gate::Mode;
use egp_wire::{Code, Timing, WireError};

use crate::world::{BUDGET, config, measurement, name, request, served, solved};

/// The request as a query, from which the world makes a reply.
fn query(payload: &[u8]) -> Query {
    Query {
        id: QueryId(0),
        replica: name("in-process"),
        key: String::new(),
        payload: payload.to_vec(),
        attachment: Vec::new(),
        listen: BUDGET,
    }
}

#[test]
fn answers_become_commands_and_errors_become_outcomes() {
    let mut vehicle = InProcessDriver::new(config(), served()).unwrap();
    let timing = Timing {
        queue_us: 0,
        step_us: 7,
        ..Timing::default()
    };
    let step = vehicle.step(measurement(), BUDGET, |payload| {
        assert_eq!(request(&query(payload)).budget_us, 16_000);
        Ok((solved(&query(payload)).encode(), timing.clone()))
    });
    let step = step.unwrap();
    assert_eq!(step.command.mode, Mode::Normal);
    assert_eq!(step.timing, Some(timing.clone()));
    assert_eq!(step.replica, Some(name("in-process")));
    assert_eq!(vehicle.driver().weights(), [0.25, 0.75]);

    let error = WireError::permanent(Code::Internal, "a defect");
    for _ in 0..3 {
        let step = vehicle.step(measurement(), BUDGET, |_| Err(error.clone()));
        assert_eq!(step.unwrap().outcome, Outcome::Refused(error.clone()));
    }
    vehicle.driver_mut().reset();
    let mut asked = 0;
    let step = vehicle.step(measurement(), BUDGET, |payload| {
        asked += 1;
        Ok((solved(&query(payload)).encode(), timing.clone()))
    });
    assert_eq!(step.unwrap().command.mode, Mode::Normal);
    assert_eq!(asked, 1);
}

#[test]
fn a_reference_that_does_not_fit_is_an_error() {
    let mut vehicle = InProcessDriver::new(config(), served()).unwrap();
    let mut short = measurement();
    short.reference.pop();
    let step = vehicle.step(short, BUDGET, |_| panic!("nothing was asked"));
    assert!(step.is_err());
    let driver: &Driver = vehicle.driver();
    assert_eq!(driver.mode(), Mode::Waiting);
}

#[test]
fn a_plan_is_made_although_the_deadline_is_over() {
    let mut vehicle = InProcessDriver::new(config(), served()).unwrap();
    let step = vehicle.step(measurement(), Duration::ZERO, |payload| {
        assert_eq!(request(&query(payload)).budget_us, 1);
        Ok((solved(&query(payload)).encode(), Timing::default()))
    });
    assert_eq!(step.unwrap().command.mode, Mode::Normal);
}
