//! Every planted fault is found by its oracle, in a run that breaks no promise without the fault.

use egp_simulate::Mutant::{self, *};
use egp_simulate::{Config, Oracle, Run, Scene, repeat, simulate};

use crate::{config, scene};

/// A fault that begins after the end of a run: the run has none.
const NONE: &[&str] = &["kill:r0@60+1"];

/// Runs with the planted faults that show in them: short ones with the fault that they need, and those of seeds.
fn runs() -> Vec<(Config, &'static [Mutant])> {
    // At all parts of a control period, also between a question and its answer.
    let jumps: Vec<String> = (0..40)
        .map(|k| format!("vehicle-clock:car-0@{:.4}+0", 1.0 + 0.1013 * f64::from(k)))
        .collect();
    let jumps: Vec<&str> = jumps.iter().map(String::as_str).collect();
    let killed = &["kill:r0@1+2"];
    let router = Config {
        routers: 1,
        ..config(5.0, &["router-kill:router-0@1+0.5"])
    };
    vec![
        (
            config(1.3, NONE),
            &[
                NoCommand,
                LateCommand,
                TwoCommands,
                Braking,
                Driving,
                ForceSlew,
                SteeringRate,
                SteeringSlew,
                NotFinite,
                Power,
                StopsEarly,
                HalfForce,
                HalfSteering,
                SteeringOvershoots,
                ChangedPlan,
                StaleReply,
                ChangedRequest,
                StuckWorker,
                TwoAnswers,
                LeakedWakes,
                RealClock,
                RandomOrder,
            ],
        ),
        (config(1.5, &["kill:r0@0+2"]), &[WaitingDrives]),
        (
            config(2.0, killed),
            &[
                LongTail,
                TailAsNormal,
                TailShifted,
                TailHeld,
                StopRepeats,
                StopDrives,
                StopCoasts,
                StopLocks,
                StopSteers,
            ],
        ),
        (config(5.8, killed), &[SteeringAngle, StopEnds, StopHolds]),
        (
            config(2.0, &["freeze:r0@1.1+0.5"]),
            &[NoDeadline, UntypedError, ErrorWithoutCode],
        ),
        (config(2.0, &["flood:r0@1.1+0.5"]), &[UnboundedQueue]),
        (
            config(5.0, &["kill:r0@1+0.2"]),
            &[
                ChangedWeights, // which exchanges them: they are equal in the first seconds
                DroppedVehicle,
                RefusedVehicle,
                LostTokens,
                LostAnswers,
                DroppedRequest,
                LeakedQueries,
            ],
        ),
        (router, &[SlowReturn, MuteRouter]),
        (
            Config::new(0),
            &[ForgottenLibrary, ExchangedLibrary, BlockingReload],
        ),
        (config(5.5, &jumps), &[StandingClock]),
        (Config::new(36), &[DroppingDrain]),
    ]
}

fn run(scene: &Scene, config: &Config, mutant: Mutant) -> Run {
    let config = Config {
        mutant: Some(mutant),
        ..config.clone()
    };
    if mutant.oracle() == Oracle::Repeat {
        repeat(scene, &config).unwrap()
    } else {
        simulate(scene, &config).unwrap()
    }
}

#[test]
fn every_planted_fault_is_found_by_its_oracle() {
    let (scene, runs) = (scene(), runs());
    for mutant in Mutant::ALL {
        let count = runs.iter().filter(|(_, here)| here.contains(mutant));
        assert_eq!(count.count(), 1, "{mutant:?}");
    }
    for (config, mutants) in &runs {
        let sound = simulate(&scene, config).unwrap();
        assert_eq!(sound.violations, [], "{config:?}");
        for &mutant in *mutants {
            let run = run(&scene, config, mutant);
            let found: Vec<Oracle> = run.violations.iter().map(|v| v.oracle).collect();
            assert!(found.contains(&mutant.oracle()), "{mutant:?}: {found:?}");
        }
    }
}
