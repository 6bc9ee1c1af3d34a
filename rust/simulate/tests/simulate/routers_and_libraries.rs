//! Libraries that are replaced while replicas serve, and routers between vehicles and replicas.

use egp_simulate::{Config, Mutant, repeat, simulate};

use crate::{config, scene, times};

#[test]
fn a_reload_costs_no_period() {
    let scene = scene();
    for two_libraries in [false, true] {
        let config = Config {
            vehicles: 2,
            two_libraries,
            ..config(
                5.0,
                &["reload:r0@0.8+1.5", "reload:r0@1.9+1", "reload:r0@3.2+0.3"],
            )
        };
        let run = repeat(&scene, &config).unwrap();
        assert_eq!(run.violations, [], "{:#?}", run.trace);
        assert_eq!(run.replied, run.periods);
        assert!(times(&run, "has loaded Library").len() >= 3);
    }
}

#[test]
fn a_vehicle_that_asks_for_another_library_gets_its_replies() {
    let config = Config {
        two_libraries: true,
        ..config(5.0, &["reload:r0@1+1"])
    };
    let run = simulate(&scene(), &config).unwrap();
    assert_eq!((run.violations.len(), run.replied), (0, run.periods));
}

/// A vehicle without a route to the service stops asking at once, and is answered soon after the router listens again.
#[test]
fn a_restarted_router_is_found_again() {
    let config = Config {
        routers: 1,
        ..config(5.0, &["router-kill:router-0@1+1.5"])
    };
    let run = repeat(&scene(), &config).unwrap();
    assert_eq!(run.violations, []);
    let solved = times(&run, "solved of r0");
    assert!(
        !solved.iter().any(|t| (1.02..2.5).contains(t)),
        "{solved:?}"
    );
    let back = solved.iter().find(|t| **t > 2.5).unwrap();
    // The attempts to connect are at most 0.2 s apart, and a token takes as long.
    assert!(*back < 2.5 + 0.2 + 0.2 + 0.03 + 0.04, "{back}");
}

/// What waits in a router that stands still for less than the lease passes on, and a longer stop closes its links.
#[test]
fn a_frozen_router_continues() {
    let scene = scene();
    for (length, lost) in [("0.5", 0), ("2.5", 2)] {
        let fault = format!("router-freeze:router-0@1+{length}");
        let config = Config {
            routers: 1,
            ..config(5.0, &[&fault])
        };
        let run = repeat(&scene, &config).unwrap();
        assert_eq!(run.violations, []);
        assert_eq!(times(&run, "has lost router 0").len(), lost, "{length}");
        let end = 1.0 + length.parse::<f64>().unwrap();
        let solved = times(&run, "solved of r0");
        assert!(
            !solved.iter().any(|t| (1.02..end).contains(t)),
            "{solved:?}"
        );
        assert!(solved.iter().any(|t| (end..end + 0.3).contains(t)));
    }
}

/// A replica that was behind the router connects to the other one.
#[test]
fn one_of_two_routers_may_end() {
    let config = Config {
        routers: 2,
        ..config(5.0, &["router-kill:router-0@1+1.5"])
    };
    let run = repeat(&scene(), &config).unwrap();
    assert_eq!(run.violations, []);
    // A token takes up to 0.2 s.
    assert!(
        run.replied + 13 > run.periods,
        "{} of {}",
        run.replied,
        run.periods
    );
}

/// Two routers deliver each question twice. Without a key one copy may be answered with `SUPERSEDED`, and with a key one is
/// answered with `UNAUTHENTICATED`.
#[test]
fn a_question_that_comes_twice_is_answered() {
    let scene = scene();
    for keys in [false, true] {
        let config = Config {
            routers: 2,
            keys,
            ..config(5.0, &["reload:r0@1+1"])
        };
        let run = repeat(&scene, &config).unwrap();
        assert_eq!((run.violations.len(), run.replied), (0, run.periods));
    }
}

/// Answers return on the links by which their question came: after its restart the first router is not the replica's, and what
/// passes through it alone waits.
#[test]
fn an_answer_takes_the_way_of_its_question() {
    let config = Config {
        routers: 2,
        ..config(
            5.0,
            &["router-kill:router-0@1+0.5", "router-freeze:router-0@2.5+1"],
        )
    };
    let run = repeat(&scene(), &config).unwrap();
    assert_eq!(run.violations, []);
    let solved = times(&run, "solved of r0");
    let frozen = solved.iter().filter(|t| (2.5..3.5).contains(*t)).count();
    assert_eq!(frozen, 50, "{solved:?}");
}

#[test]
fn faults_of_routers_and_libraries_that_are_planted_are_found() {
    let scene = scene();
    for (mutant, routers, keys, faults) in [
        (Mutant::SlowReturn, 1, false, "router-kill:router-0@1+0.5"),
        (Mutant::MuteRouter, 1, false, "router-kill:router-0@1+0.5"),
        (Mutant::ForgottenLibrary, 0, true, "reload:r0@1+3"),
        (Mutant::ExchangedLibrary, 0, true, "reload:r0@1+3"),
        (Mutant::BlockingReload, 0, true, "reload:r0@1+3"),
    ] {
        // A reload may find a broken file, which changes nothing.
        let found = (0..10).any(|seed| {
            let config = Config {
                seed,
                routers,
                keys,
                mutant: Some(mutant),
                ..config(5.0, &[faults])
            };
            let run = simulate(&scene, &config).unwrap();
            run.violations.iter().any(|v| v.oracle == mutant.oracle())
        });
        assert!(found, "{mutant:?}");
    }
}

#[test]
fn a_fault_of_a_router_that_does_not_take_part_is_an_error() {
    let error = simulate(&scene(), &config(5.0, &["router-freeze:router-0@1+1"])).unwrap_err();
    assert!(error.to_string().contains("--routers"), "{error}");
}
