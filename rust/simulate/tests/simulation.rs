//! A few seeds without a violation, and planted faults that are found.
#![allow(clippy::unwrap_used)]

use std::path::PathBuf;

use egp_simulate::{Config, Mutant, Oracle, Scene, repeat, simulate};

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
