//! A replica is asked for steps only after it has described what the vehicle needs.

use std::time::Duration;

use egp_driver::{Driver, Outcome, Query};
use egp_gate::Mode;
use egp_parameters::VehicleParameters;
use egp_wire::{Code, Ready};

use crate::world::{
    BUDGET, CAR, LISTEN, PERIOD, answered_period, appear, asked, decided, driver, error, ms, name,
    probed, served, solved, tick,
};

/// The description of a replica whose settings state another mass.
fn heavy() -> Ready {
    let vehicle = VehicleParameters {
        mass: 1800.0,
        ..CAR
    };
    Ready {
        vehicle: Some(vehicle),
        ..served()
    }
}

/// A driver whose replica `a` fits, while `b` has only announced itself.
fn one_of_two() -> Driver {
    let mut driver = driver(&["a"]);
    driver.replica_appeared(name("b"));
    driver
}

/// Opens a period in which a replica is probed and `a` is asked, and returns the probe.
fn probing_period(driver: &mut Driver, now: Duration) -> Query {
    tick(driver, now);
    let probe = probed(driver);
    let query = asked(driver);
    assert_eq!(query.replica, name("a"));
    driver.replied(now, query.id, &solved(&query).encode(), b"");
    assert!(decided(driver).outcome.is_solved());
    probe
}

/// The replicas that are asked when none answers, in their order.
fn all_asked(driver: &mut Driver, now: Duration) -> Vec<String> {
    tick(driver, now);
    let mut order = Vec::new();
    while let Some(egp_driver::Action::Ask(query)) = driver.next_action() {
        order.push(query.replica.to_string());
        driver.refused(now, query.id, &error(Code::Overloaded));
    }
    order.sort();
    order
}

#[test]
fn a_replica_that_plans_for_another_vehicle_is_not_asked() {
    let foreign = Ready {
        library: [8; 32],
        ..served()
    };
    // The description is of the vehicle of `library`, not of those of the others.
    let other = Ready {
        library: [8; 32],
        others: vec![served().library],
        ..heavy()
    };
    let ending = Ready {
        ready: false,
        ..served()
    };
    let closed = Ready {
        sealed: true,
        ..served()
    };
    let older = Ready {
        vehicle: None,
        ..served()
    };
    // Horizon and history belong to the settings of a replica, and it answers requests of other lengths with an error.
    let with = |horizon, history| Ready {
        horizon,
        history,
        ..served()
    };
    let Ready {
        horizon, history, ..
    } = served();
    for (description, fits) in [
        (with(horizon - 1, history).encode(), false),
        (with(horizon, history - 1).encode(), false),
        (with(horizon, history + 1).encode(), true),
        (served().encode(), true),
        (older.encode(), true),
        (other.encode(), true),
        (heavy().encode(), false),
        (foreign.encode(), false),
        (ending.encode(), false),
        (closed.encode(), false),
        (b"noise".to_vec(), false),
    ] {
        let mut driver = one_of_two();
        let probe = probing_period(&mut driver, ms(20));
        assert_eq!(probe.key, "egp/v1/r/b/ready");
        assert_eq!(all_asked(&mut driver, ms(40)), ["a"]);
        driver.replied(ms(41), probe.id, &description, b"");
        let expected: &[&str] = if fits { &["a", "b"] } else { &["a"] };
        assert_eq!(all_asked(&mut driver, ms(60)), expected);
        // One that does not fit is asked what it serves again, because that may change.
        if !fits {
            let probe = probing_period(&mut driver, ms(220));
            driver.replied(ms(221), probe.id, &served().encode(), b"");
            assert_eq!(all_asked(&mut driver, ms(240)), ["a", "b"]);
        }
    }
}

#[test]
fn a_description_counts_although_it_comes_late() {
    let mut driver = one_of_two();
    let probe = probing_period(&mut driver, ms(20));
    driver.replied(ms(20) + 5 * PERIOD, probe.id, &served().encode(), b"");
    assert_eq!(all_asked(&mut driver, ms(140)), ["a", "b"]);
}

#[test]
fn the_only_replica_is_asked_in_the_period_in_which_it_describes_itself() {
    let mut driver = driver(&[]);
    driver.replica_appeared(name("a"));
    tick(&mut driver, ms(20));
    let probe = probed(&mut driver);
    assert!(driver.next_action().is_none(), "the description may come");
    assert_eq!(driver.next_wake(), Some(ms(20) + BUDGET));
    driver.replied(ms(22), probe.id, &served().encode(), b"");
    let query = asked(&mut driver);
    assert_eq!(query.listen, ms(14) + LISTEN);
    driver.replied(ms(23), query.id, &solved(&query).encode(), b"");
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.asked), (Mode::Normal, 1));
}

#[test]
fn without_a_replica_that_fits_the_vehicle_waits_braked() {
    type End = fn(&mut Driver, &Query);
    let ends: [(End, Outcome); 6] = [
        (
            |driver, probe| driver.replied(ms(21), probe.id, &heavy().encode(), b""),
            Outcome::Unreachable,
        ),
        (
            |driver, probe| driver.replied(ms(21), probe.id, b"noise", b""),
            Outcome::Unreachable,
        ),
        (
            |driver, probe| driver.refused(ms(21), probe.id, &error(Code::Internal)),
            Outcome::Unreachable,
        ),
        (
            |driver, probe| driver.ended(ms(21), probe.id),
            Outcome::Unreachable,
        ),
        (
            |driver, probe| driver.replica_gone(ms(21), &probe.replica),
            Outcome::Unreachable,
        ),
        (|driver, _| driver.wake(ms(36)), Outcome::Late),
    ];
    for (end, outcome) in ends {
        let mut driver = driver(&[]);
        driver.replica_appeared(name("a"));
        tick(&mut driver, ms(20));
        let probe = probed(&mut driver);
        end(&mut driver, &probe);
        let step = decided(&mut driver);
        assert_eq!((step.outcome, step.asked, step.replica), (outcome, 0, None));
        assert_eq!(step.command.mode, Mode::Waiting);
    }
}

#[test]
fn a_replica_that_fits_takes_over_in_the_period_in_which_the_other_one_fails() {
    let mut driver = one_of_two();
    tick(&mut driver, ms(20));
    let (probe, first) = (probed(&mut driver), asked(&mut driver));
    driver.ended(ms(21), first.id);
    assert!(driver.next_action().is_none());
    driver.replied(ms(22), probe.id, &served().encode(), b"");
    let second = asked(&mut driver);
    assert_eq!(second.replica, name("b"));
    driver.replied(ms(23), second.id, &solved(&second).encode(), b"");
    assert_eq!(decided(&mut driver).asked, 2);
}

#[test]
fn a_process_of_the_same_name_describes_itself_anew() {
    let mut driver = driver(&["a"]);
    driver.replica_appeared(name("b"));
    let probe = probing_period(&mut driver, ms(20));
    driver.replica_gone(ms(30), &name("b"));
    driver.replica_appeared(name("b"));
    // This is an answer of the process that has gone.
    driver.replied(ms(32), probe.id, &served().encode(), b"");
    let probe = probing_period(&mut driver, ms(40));
    assert_eq!(probe.replica, name("b"));
    driver.replied(ms(41), probe.id, &served().encode(), b"");
    assert_eq!(all_asked(&mut driver, ms(60)), ["a", "b"]);
}

#[test]
fn a_replica_that_went_is_not_asked_later_in_the_period() {
    let mut driver = driver(&["a", "b"]);
    tick(&mut driver, ms(20));
    let query = asked(&mut driver);
    let mut both = ["a", "b"].map(name).into_iter();
    let other = both.find(|name| *name != query.replica).unwrap();
    driver.replica_gone(ms(21), &other);
    driver.replica_appeared(other);
    driver.ended(ms(23), query.id);
    assert_eq!(decided(&mut driver).asked, 1);
}

#[test]
fn a_reset_leaves_what_is_known_of_replicas() {
    let mut driver = one_of_two();
    tick(&mut driver, ms(20));
    driver.reset();
    let probe = probed(&mut driver);
    assert!(driver.next_action().is_none());
    driver.replied(ms(22), probe.id, &served().encode(), b"");
    appear(&mut driver, &name("c"));
    assert_eq!(all_asked(&mut driver, ms(40)), ["a", "b", "c"]);
    assert!(["a", "b", "c"].contains(&answered_period(&mut driver, ms(60)).as_str()));
}
