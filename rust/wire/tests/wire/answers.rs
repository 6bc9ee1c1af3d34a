//! Both sides of every limit of what a service answers: replies and descriptions of a replica.

use egp_testing::messages;
use egp_wire::{Friction, Ready, Reply, Status, limits};

use crate::borders::{decoded_reply, field, refused_reply};

#[test]
fn only_a_solved_reply_has_a_plan() {
    let solved = messages::solved_reply;
    let spoiled = [
        Reply {
            status: Status::Unspecified,
            ..messages::infeasible_reply()
        },
        Reply {
            plan_u: vec![],
            plan_x: vec![[0.0; 7]],
            ..solved()
        },
        Reply {
            plan_x: vec![[0.0; 7]; 4],
            ..solved()
        },
        Reply {
            plan_x: vec![[0.0; 7]; 6],
            ..solved()
        },
        Reply {
            plan_x: vec![[0.0; 7]; 5],
            ..messages::infeasible_reply()
        },
        Reply {
            plan_u: vec![[0.0; 2]; 4],
            ..messages::infeasible_reply()
        },
    ];
    let fields = spoiled.each_ref().map(refused_reply);
    let (x, u) = (Some("plan_x"), Some("plan_u"));
    assert_eq!(fields, [Some("status"), u, x, x, u, u]);
}

#[test]
fn a_reply_is_checked_like_a_request() {
    let mut fast = messages::solved_reply();
    fast.plan_x[2][2] = 151.0;
    let mut strong = messages::solved_reply();
    strong.plan_u[1][0] = 2e6;
    let spoiled = [
        fast,
        strong,
        Reply {
            weights: vec![],
            ..messages::solved_reply()
        },
        Reply {
            weights: vec![0.6, 0.6],
            ..messages::solved_reply()
        },
        Reply {
            weights: vec![1.0],
            ..messages::solved_reply()
        },
    ];
    let fields = spoiled
        .each_ref()
        .map(|reply| refused_reply(reply).unwrap());
    assert_eq!(
        fields,
        ["plan_x", "plan_u", "weights", "weights", "history_f"]
    );
}

#[test]
fn numbers_about_the_qp_and_deviations_are_accepted_up_to_their_limits() {
    let dropped = |dropped_mass| Reply {
        dropped_mass,
        ..messages::solved_reply()
    };
    for accepted in [-9e-7, 0.0, 1.0, 1.0 + 9e-7] {
        let reply = dropped(accepted);
        assert_eq!(decoded_reply(&reply).unwrap(), reply);
    }
    for spoiled in [-2e-6, 1.0 + 2e-6, f64::NAN, f64::INFINITY] {
        assert_eq!(refused_reply(&dropped(spoiled)), Some("dropped_mass"));
    }

    let residual = |kkt_residual, reply: Reply| Reply {
        kkt_residual,
        ..reply
    };
    for (accepted, like) in [
        (0.0, messages::solved_reply()),
        (f64::MAX, messages::solved_reply()),
        (f64::INFINITY, messages::infeasible_reply()),
    ] {
        let reply = residual(accepted, like);
        assert_eq!(decoded_reply(&reply).unwrap(), reply);
    }
    for (spoiled, like) in [
        (f64::INFINITY, messages::solved_reply()),
        (-1e-300, messages::solved_reply()),
        (f64::NAN, messages::solved_reply()),
        (-1e-300, messages::infeasible_reply()),
        (f64::NAN, messages::infeasible_reply()),
    ] {
        assert_eq!(
            refused_reply(&residual(spoiled, like)),
            Some("kkt_residual"),
            "{spoiled}"
        );
    }

    let mut reply = messages::solved_reply();
    reply.sigma[4][2] = 0.0;
    assert_eq!(decoded_reply(&reply).unwrap(), reply);
    for spoiled in [-1e-300, f64::NAN] {
        reply.sigma[4][2] = spoiled;
        assert_eq!(refused_reply(&reply), Some("sigma"), "{spoiled}");
    }
}

#[test]
fn a_replica_is_described_within_the_limits_of_the_client() {
    let bound = |limit: usize| u32::try_from(limit).unwrap();
    let decode = |ready: &Ready| Ready::decode(&ready.encode());
    for (dt, horizon, history) in [
        (1.0, bound(limits::HORIZON), bound(limits::HISTORY)),
        (1e-3, 1, 0),
    ] {
        let ready = Ready {
            dt,
            horizon,
            history,
            ..messages::ready()
        };
        assert_eq!(decode(&ready).unwrap(), ready);
    }
    let hostile = Ready {
        members: vec!["ice\u{1b}[31m".to_owned()],
        ..messages::ready()
    };
    assert_eq!(decode(&hostile).unwrap().members, ["ice\u{fffd}[31m"]);
    for dt in [0.0, -0.05, 1e-4 - 1e-9, 1.0 + 1e-9, f64::NAN, f64::INFINITY] {
        let ready = Ready {
            dt,
            ..messages::ready()
        };
        assert_eq!(field(&decode(&ready)), Some("dt"), "{dt}");
    }
    let (long, deep) = (bound(limits::HORIZON) + 1, bound(limits::HISTORY) + 1);
    let long = Ready {
        horizon: long,
        ..messages::ready()
    };
    assert_eq!(field(&decode(&long)), Some("horizon"));
    let deep = Ready {
        history: deep,
        ..messages::ready()
    };
    assert_eq!(field(&decode(&deep)), Some("history"));
    let without_a_plan = Ready {
        horizon: 0,
        ..messages::ready()
    };
    assert_eq!(field(&decode(&without_a_plan)), Some("horizon"));
    let of = |members: usize| Ready {
        members: vec!["dry".to_owned(); members],
        ..messages::ready()
    };
    for accepted in [of(1), of(limits::MEMBERS)] {
        assert_eq!(decode(&accepted).unwrap(), accepted);
    }
    for spoiled in [of(0), of(limits::MEMBERS + 1)] {
        assert_eq!(field(&decode(&spoiled)), Some("members"));
    }
    let with = |others: usize| Ready {
        others: vec![[9; 32]; others],
        ..messages::ready()
    };
    assert_eq!(
        decode(&with(Ready::MAX_OTHERS)).unwrap(),
        with(Ready::MAX_OTHERS)
    );
    assert_eq!(field(&decode(&with(Ready::MAX_OTHERS + 1))), Some("others"));
    let several = with(2);
    assert!(several.serves(&[9; 32]) && several.serves(&several.library));
    assert!(!several.serves(&[8; 32]));
    assert_eq!(several.libraries(), [several.library, [9; 32], [9; 32]]);
}

#[test]
fn the_envelope_has_a_finite_width_in_every_component() {
    let decode = |ready: &Ready| Ready::decode(&ready.encode());
    let with = |low: f64, high: f64| {
        let mut ready = messages::ready();
        (ready.envelope[0][3], ready.envelope[1][3]) = (low, high);
        ready
    };
    for (low, high) in [(-1e307, 1e307), (0.0, 1e-300), (-2.0, -1.0)] {
        assert_eq!(decode(&with(low, high)).unwrap(), with(low, high));
    }
    for (low, high) in [
        (0.5, 0.5),
        (0.5, -0.5),
        (0.0, f64::INFINITY),
        (f64::NEG_INFINITY, 0.0),
        (f64::NAN, 0.5),
        (-1.7e308, 1.7e308),
    ] {
        let result = decode(&with(low, high));
        assert_eq!(field(&result), Some("envelope"), "{low} {high}");
    }
}

#[test]
fn a_friction_is_accepted_up_to_its_limits() {
    let with = |change: fn(&mut Friction)| {
        let mut reply = messages::solved_reply();
        let mut friction = reply.friction.unwrap();
        change(&mut friction);
        reply.friction = Some(friction);
        reply
    };
    let none = Reply {
        friction: None,
        ..messages::solved_reply()
    };
    let accepted: [fn(&mut Friction); 6] = [
        |f| (f.mean, f.upper) = (10.0, 10.0),
        |f| (f.lower, f.upper) = (0.5, 0.5),
        |f| f.information = 1e3,
        |f| f.log_likelihood = [-1e6; 17],
        |f| f.misfit = 0.0,
        |f| f.misfit = 1e9,
    ];
    for reply in accepted.map(with).into_iter().chain([none]) {
        assert_eq!(decoded_reply(&reply).unwrap(), reply);
    }
    let spoiled: [fn(&mut Friction); 10] = [
        |f| f.mean = f64::NAN,
        |f| f.mean = 10.1,
        |f| f.std = -0.1,
        |f| (f.lower, f.upper) = (0.6, 0.5),
        |f| f.information = 1.1e3,
        |f| f.log_likelihood[3] = 0.1,
        |f| f.log_likelihood[16] = -1.1e6,
        |f| f.log_likelihood[0] = f64::NAN,
        |f| f.misfit = -0.1,
        |f| f.misfit = 1.1e9,
    ];
    for reply in spoiled.map(with) {
        assert_eq!(refused_reply(&reply), Some("friction"));
    }
}

#[test]
fn a_friction_is_informed_from_a_tenth_of_a_nat_on() {
    let informed = |information| {
        let friction = messages::solved_reply().friction.unwrap();
        Friction {
            information,
            ..friction
        }
        .informed()
    };
    assert_eq!(
        [0.0, 0.1 - 1e-9, 0.1, 3.0].map(informed),
        [false, false, true, true]
    );
}
