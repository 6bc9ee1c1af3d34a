//! A few seeds without a violation, and planted faults that are found.
#![allow(clippy::unwrap_used)]

use std::path::PathBuf;

use egp_simulate::{Config, Mutant, Oracle, Scene, ScheduledFault, repeat, simulate};

fn scene() -> Scene {
    let shipped =
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../python/egp_service/shipped");
    Scene::load(
        &shipped.join("demo-library.safetensors"),
        &shipped.join("evaluation-library.safetensors"),
    )
    .unwrap()
}

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

/// One planted fault for each oracle but `Repeat`, with a seed that finds it; `egp-simulate --planted` tries all.
#[test]
fn each_oracle_finds_its_planted_fault() {
    let scene = scene();
    for mutant in [
        Mutant::NoDeadline,
        Mutant::ForceSlew,
        Mutant::TailAsNormal,
        Mutant::ChangedPlan,
        Mutant::RefusedVehicle,
        Mutant::StuckWorker,
        Mutant::UntypedError,
        Mutant::LeakedQueries,
    ] {
        let found: Vec<Oracle> = (0..10)
            .flat_map(|seed| {
                let config = Config {
                    mutant: Some(mutant),
                    ..Config::new(seed)
                };
                simulate(&scene, &config).unwrap().violations
            })
            .map(|violation| violation.oracle)
            .take(1)
            .collect();
        assert!(found.contains(&mutant.oracle()), "{mutant:?}: {found:?}");
    }
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
    let periods = |trace: &[String], mode: &str| {
        let lines = trace.iter().filter(|line| line.contains(mode));
        lines
            .map(|line| line.trim().split(' ').next().unwrap().parse().unwrap())
            .collect::<Vec<f64>>()
    };
    let short = run(&["kill:r0@1+2", "freeze:r1@1.5+0.2"]).unwrap();
    assert_eq!((short.faults, short.violations.len()), (2, 0));
    let tail = periods(&short.trace, " Tail ");
    assert!(tail.len() >= 8, "{tail:?}");
    assert!(tail.iter().all(|t| (1.0..1.8).contains(t)), "{tail:?}");
    assert!(periods(&short.trace, " Stop ").is_empty());
    let long = run(&["kill:r0@1+2", "freeze:r1@1.5+1"]).unwrap();
    assert!(!periods(&long.trace, " Stop ").is_empty());
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
    let starts: Vec<&str> = run
        .trace
        .iter()
        .filter(|line| line.ends_with("r0 starts"))
        .map(|line| line.trim().split(' ').next().unwrap())
        .collect();
    assert_eq!(starts, ["0.000000", "3.550000"], "drained at 2.5 s");
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
