//! A few seeds without a violation, and planted faults that are found.

use egp_simulate::{Config, Mutant, Oracle, ScheduledFault, repeat, simulate};

use crate::{config, scene, times};

#[test]
fn no_promise_is_broken_and_every_seed_repeats() {
    let scene = scene();
    for seed in 0..4 {
        let run = repeat(&scene, &Config::new(seed)).unwrap();
        assert_eq!(run.violations, [], "seed {seed}: {:#?}", run.trace);
        assert!(
            run.faults > 0 && 2 * run.replied > run.periods,
            "seed {seed}"
        );
    }
}

/// A fault that begins after the end of a run: the run has none.
const NONE: &[&str] = &["kill:r0@60+1"];

/// Each of these faults breaks one promise only, and is found by the words of one check of its oracle.
#[test]
fn faults_of_stops_and_of_braking_are_found_by_their_own_check() {
    let scene = scene();
    let killed = &["kill:r0@1+2"][..];
    for (mutant, seconds, faults, words) in [
        (
            Mutant::StopsEarly,
            1.5,
            NONE,
            "mode Stop with a plan of age Some(0), due is Normal",
        ),
        (
            Mutant::StopEnds,
            4.0,
            killed,
            "mode Normal with a plan of age Some(0), due is Stop",
        ),
        (Mutant::StopCoasts, 2.0, killed, "in mode Stop"),
        (Mutant::StopLocks, 2.0, killed, "in mode Stop"),
        (Mutant::StopHolds, 5.8, killed, "in mode Stop"),
        (Mutant::StopSteers, 2.0, killed, "in mode Stop"),
        (
            Mutant::WaitingDrives,
            1.5,
            &["kill:r0@0+2"],
            "in mode Waiting",
        ),
        (Mutant::HalfForce, 1.5, NONE, "in mode Normal"),
        (Mutant::HalfSteering, 1.5, NONE, "in mode Normal"),
        (Mutant::SteeringOvershoots, 1.5, NONE, "in mode Normal"),
    ] {
        let config = Config {
            mutant: Some(mutant),
            ..config(seconds, faults)
        };
        let run = simulate(&scene, &config).unwrap();
        let found: Vec<Oracle> = run.violations.iter().map(|v| v.oracle).collect();
        assert_eq!(found, [Oracle::Tail], "{mutant:?}: {:?}", run.violations);
        let detail = &run.violations[0].detail;
        assert!(detail.contains(words), "{mutant:?}: {detail}");
    }
}

/// A stop ends in standstill, for which its force decreases below 0.5 m/s.
#[test]
fn a_stop_is_judged_down_to_standstill() {
    let run = simulate(&scene(), &config(9.0, &["kill:r0@1+2"])).unwrap();
    assert_eq!(run.violations, []);
    let speed = |line: &str| -> f64 {
        let (_, after) = line.split_once("rad/s at ").unwrap();
        after.split_once(" m/s").unwrap().0.parse().unwrap()
    };
    let stops = run.trace.iter().filter(|line| line.contains(" Stop "));
    let slow = stops.filter(|line| speed(line) < 0.5).count();
    assert!(slow > 5, "{slow}");
    assert_eq!(times(&run, "is put back on its course").len(), 1);
}

#[test]
fn faults_of_power_and_steering_angle_are_found_by_their_own_check() {
    let scene = scene();
    for (mutant, words) in [
        (Mutant::Power, "car-0: power of"),
        (Mutant::SteeringAngle, "car-0: steering angle of"),
    ] {
        let config = Config {
            mutant: Some(mutant),
            ..config(9.0, NONE)
        };
        let run = simulate(&scene, &config).unwrap();
        let found = run.violations.iter().find(|v| v.oracle == Oracle::Limits);
        let detail = &found.unwrap().detail;
        assert!(detail.starts_with(words), "{mutant:?}: {detail}");
    }
}

#[test]
fn events_that_are_planned_without_bound_are_found() {
    let config = Config {
        mutant: Some(Mutant::LeakedWakes),
        ..config(2.0, NONE)
    };
    let run = simulate(&scene(), &config).unwrap();
    let found: Vec<Oracle> = run.violations.iter().map(|v| v.oracle).collect();
    assert_eq!(found, [Oracle::Memory]);
    let detail = &run.violations[0].detail;
    assert!(detail.contains("events are planned"), "{detail}");
}

/// Many vehicles and replicas connect to a router again at the same time, which is no fault.
#[test]
fn the_bound_of_events_is_that_of_the_whole_run() {
    let config = Config {
        vehicles: 100,
        replicas: 100,
        routers: 1,
        ..config(1.3, &["router-restart:router-0@1+0"])
    };
    let run = simulate(&scene(), &config).unwrap();
    assert_eq!(run.violations, []);
}

#[test]
fn scheduled_faults_replace_those_of_the_seed() {
    let scene = scene();
    let run = |faults: &[&str]| {
        let config = Config {
            vehicles: 1,
            replicas: 2,
            seconds: 4.0,
            recorded: true,
            faults: faults.iter().map(|text| text.parse().unwrap()).collect(),
            ..Config::new(0)
        };
        repeat(&scene, &config)
    };
    let short = run(&["kill:r0@1+2", "freeze:r1@1.5+0.2"]).unwrap();
    assert_eq!((short.faults, short.violations.len()), (2, 0));
    let tail = times(&short, " Tail ");
    assert!(tail.len() >= 8, "{tail:?}");
    assert!(tail.iter().all(|t| (1.0..1.8).contains(t)), "{tail:?}");
    assert!(times(&short, " Stop ").is_empty());
    let long = run(&["kill:r0@1+2", "freeze:r1@1.5+1"]).unwrap();
    assert!(!times(&long, " Stop ").is_empty());
    let error = run(&["partition:car-1:r0@1+1"]).unwrap_err();
    assert!(error.to_string().contains("--vehicles"), "{error}");
}

/// The vehicle stops while its only replica is dead for five seconds, which is no fault of the replica or the driver.
#[test]
fn nobody_is_starved_while_no_replica_is_within_reach() {
    for fault in ["kill:r0@1+5", "partition:car-0:r0@1+5", "hostile:r0@1+5"] {
        let config = Config {
            vehicles: 1,
            replicas: 1,
            seconds: 7.0,
            faults: vec![fault.parse().unwrap()],
            ..Config::new(0)
        };
        let run = simulate(&scene(), &config).unwrap();
        assert_eq!(run.violations, [], "{fault}");
        assert!(run.replied + 200 < run.periods, "{fault}: {}", run.replied);
    }
}

/// A stopped process cannot answer what it has received, and drains when it continues.
#[test]
fn a_frozen_replica_drains_when_it_continues() {
    let config = Config {
        recorded: true,
        seconds: 5.0,
        faults: ["freeze:r0@1+1.5", "drain:r0@1.2+1"]
            .iter()
            .map(|text| text.parse().unwrap())
            .collect(),
        ..Config::new(0)
    };
    let run = simulate(&scene(), &config).unwrap();
    assert_eq!(run.violations, []);
    assert_eq!(times(&run, "r0 starts"), [0.0, 3.55], "drained at 2.5 s");
}

/// A stopped process does not complete its drain, and a new one starts when it has ended.
#[test]
fn a_replica_that_is_frozen_in_its_drain_completes_it_later() {
    for (faults, start) in [
        (["drain:r0@1+0", "freeze:r0@1.02+0.5"], 2.52),
        (["drain:r0@1+0", "freeze:r0@1.02+1.5"], 3.52),
        (["drain:r0@1+0", "freeze:r0@1.5+1.5"], 4.0),
    ] {
        let run = simulate(&scene(), &config(5.0, &faults)).unwrap();
        assert_eq!(run.violations, [], "{faults:?}");
        assert_eq!(times(&run, "r0 starts"), [0.0, start], "{faults:?}");
    }
}

/// A freeze is one of a process: the next process is not frozen, and the end of the freeze does not concern it.
#[test]
fn a_replica_that_was_frozen_and_killed_starts_anew() {
    let faults = ["freeze:r0@1+2.5", "kill:r0@1.5+0.5", "freeze:r0@3+1"];
    let run = simulate(&scene(), &config(5.0, &faults)).unwrap();
    assert_eq!(run.violations, []);
    let solved = times(&run, "solved of r0");
    let between = |a: f64, b: f64| solved.iter().any(|t| (a..b).contains(t));
    assert!(between(2.0, 2.3), "{solved:?}");
    assert!(!between(3.02, 4.0), "the second freeze lasts: {solved:?}");
    assert!(between(4.0, 4.3), "{solved:?}");
    assert_eq!(times(&run, "Freeze(0) ends"), [4.0]);
}

#[test]
fn faults_that_are_not_understood_are_errors() {
    for text in [
        "",
        "kill",
        "kill:r0",
        "kill:r0@1",
        "kill:0@1+1",
        "kill:r0@-1+1",
        "kill:r0@1+nan",
        "kill:car-0@1+1",
        "partition:r0:car-0@1+1",
        "partition:car-0@1+1",
        "explode:r0@1+1",
        "router-kill:r0@1+1",
        "freeze:router-0@1+1",
    ] {
        let error = text.parse::<ScheduledFault>().unwrap_err();
        assert!(error.contains("such as kill:r0@1.5+2"), "{text}: {error}");
    }
    for text in [
        "half-open:car-1:r2@0+0.5",
        "vehicle-clock:car-0@1+0",
        "replica-clock:r1@1e0+0",
        "other-library:r1@1+1",
        "router-restart:router-1@1+0",
    ] {
        assert!(text.parse::<ScheduledFault>().is_ok(), "{text}");
    }
}
