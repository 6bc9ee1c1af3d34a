//! What a belief knows, and how it is stored.

use egp_map::RoadBelief;
use egp_parameters::{FRICTION_HYPOTHESES, LEAST_LOG_LIKELIHOOD, friction_hypotheses};

use super::{LENGTH, belief, drive, evidence, quantiles};

#[test]
fn nothing_is_known_at_first() {
    for (found, share) in quantiles(&mut belief(), 123.0)
        .iter()
        .zip([0.05, 0.5, 0.95])
    {
        assert!(
            (found - (0.1 + 1.2 * share)).abs() < 0.01,
            "{found} {share}"
        );
    }
}

#[test]
fn a_lap_is_remembered_with_its_borders() {
    let mut belief = belief();
    let truth = |s: f64| if s < 200.0 { 0.9 } else { 0.4 };
    drive(&mut belief, 0.0, LENGTH + 10.0, |s| {
        Some(evidence(truth(s)))
    });
    for s in [20.0, 100.0, 190.0, 210.0, 300.0, 480.0] {
        let [low, middle, high] = quantiles(&mut belief, s);
        let mu = truth(s);
        assert!((middle - mu).abs() < 0.04, "{s}: {low} {middle} {high}");
        assert!(
            low > 0.85 * mu && high < 1.15 * mu,
            "{s}: {low} {middle} {high}"
        );
    }
    let mut friction = [0.0; 251];
    belief.ahead(100.0, 1.0, 0.05, &mut friction).unwrap();
    assert!(
        friction[..85].iter().all(|mu| (0.75..0.9).contains(mu)),
        "{friction:?}"
    );
    assert!(
        friction[115..].iter().all(|mu| (0.33..0.4).contains(mu)),
        "{friction:?}"
    );
}

#[test]
fn what_is_known_fades_with_the_distance() {
    // On a lap, what is known would lie ahead, too.
    let mut belief = RoadBelief::new(LENGTH, false).unwrap();
    drive(&mut belief, 0.0, 100.0, |_| Some(evidence(0.9)));
    let lower = [90.0, 130.0, 200.0, 300.0].map(|s| belief.quantile(s, 0.1).unwrap());
    assert!(lower.windows(2).all(|pair| pair[0] > pair[1]), "{lower:?}");
    let mut friction = [0.0; 2];
    let mut planned = |s: f64, risk| {
        belief.ahead(s, 1.0, risk, &mut friction).unwrap();
        friction[0]
    };
    // A patch is likelier than 5 %, and where nothing was measured within 8 m it may have any friction.
    assert!((0.3..0.5).contains(&planned(113.0, 0.05)));
    assert!(planned(90.0, 0.05) > 0.7);
    assert!(planned(113.0, 0.3) > 0.8);
}

#[test]
fn a_stretch_between_two_that_are_known_may_be_a_patch() {
    let mut belief = belief();
    drive(&mut belief, 0.0, 100.0, |_| Some(evidence(0.9)));
    belief.leave();
    drive(&mut belief, 140.0, 240.0, |_| Some(evidence(0.9)));
    let mut friction = [0.0; 91];
    belief.ahead(80.0, 1.0, 0.05, &mut friction).unwrap();
    let places = |from: usize, to: usize| &friction[from - 80..to - 80];
    assert!(places(80, 85).iter().all(|mu| *mu > 0.75), "{friction:?}");
    assert!(
        places(115, 125).iter().all(|mu| (0.3..0.5).contains(mu)),
        "{friction:?}"
    );
    assert!(places(160, 170).iter().all(|mu| *mu > 0.75), "{friction:?}");
    // The road on both sides is nevertheless the likeliest indication.
    assert!(belief.quantile(120.0, 0.5).unwrap() > 0.8);
}

#[test]
fn differences_that_errors_of_the_models_explain_do_not_add_up() {
    // Each window prefers little friction by 0.2 nats, as on a straight, or excludes less than 0.4, as in a bend.
    let straight = friction_hypotheses().map(|mu| -0.2 * (mu / 1.3));
    let bend = friction_hypotheses().map(|mu| if mu < 0.4 { -3.0 } else { 0.0 });
    let mut belief = belief();
    let empty = belief.to_bytes().unwrap();
    drive(&mut belief, 0.0, 10.0 * LENGTH, |_| Some(straight));
    belief.leave();
    assert_eq!(belief.to_bytes().unwrap(), empty);
    assert!(belief.take_changed().is_empty());
    drive(&mut belief, 0.0, 60.0, |_| Some(bend));
    assert_eq!(belief.take_changed(), [0]);
    let [low, ..] = quantiles(&mut belief, 40.0);
    assert!(low > 0.38, "{low}");
}

#[test]
fn another_window_is_that_of_a_new_belief_and_the_same_one_changes_nothing() {
    let with = |window| {
        let mut belief = belief();
        belief.set_window(window).unwrap();
        belief
    };
    let (mut changed, mut new) = (belief(), with(10));
    assert_eq!(changed.window(), 25);
    drive(&mut changed, 0.0, 20.0, |_| None);
    changed.set_window(10).unwrap();
    assert_eq!(changed.window(), 10);
    for belief in [&mut changed, &mut new] {
        drive(belief, 100.0, 110.0, |_| Some(evidence(0.5)));
        belief.set_window(10).unwrap();
        drive(belief, 110.0, 120.0, |_| Some(evidence(0.5)));
    }
    assert_eq!(changed.to_bytes().unwrap(), new.to_bytes().unwrap());
    for window in [0, 1001] {
        assert!(changed.set_window(window).is_err());
    }
}

#[test]
fn a_jump_of_more_than_a_lap_is_found_on_a_place_that_is_unwrapped() {
    // A jump of 200 m, with and without a further lap, forgets where the vehicle was.
    let after = |jump: f64| {
        let mut belief = belief();
        drive(&mut belief, 10.0, 20.0, |_| None);
        for period in 0..4 {
            let s = 20.0 + jump + 0.2 * f64::from(period);
            belief.update(s, Some(&evidence(0.3))).unwrap();
        }
        belief.to_bytes().unwrap()
    };
    assert_eq!(after(200.0), belief().to_bytes().unwrap());
    assert_eq!(after(200.0 + LENGTH), after(200.0));
}

#[test]
fn new_evidence_contradicts_old() {
    let mut belief = belief();
    drive(&mut belief, 0.0, 20.0 * LENGTH, |_| Some(evidence(1.0)));
    drive(&mut belief, 0.0, 60.0, |_| Some(evidence(0.3)));
    let [_, middle, _] = quantiles(&mut belief, 40.0);
    let mut twice = belief.clone();
    drive(&mut twice, 0.0, 60.0, |_| Some(evidence(0.3)));
    let [_, again, _] = quantiles(&mut twice, 40.0);
    assert!(middle < 0.6 && again < 0.35, "{middle} {again}");
}

#[test]
fn periods_without_evidence_and_jumps_add_nothing() {
    let mut belief = belief();
    let empty = belief.to_bytes().unwrap();
    drive(&mut belief, 0.0, 100.0, |_| None);
    assert_eq!(belief.to_bytes().unwrap(), empty);
    belief.leave();
    for period in 0..200 {
        // Backwards, which no path planner does.
        let s = 300.0 - 0.2 * f64::from(period);
        belief.update(s, Some(&evidence(0.5))).unwrap();
    }
    assert_eq!(belief.to_bytes().unwrap(), empty);
}

#[test]
fn the_newest_window_counts_at_the_vehicle_before_it_is_stored() {
    let mut belief = belief();
    let truth = |s: f64| if s < 200.0 { 0.9 } else { 0.4 };
    // Each window knows the friction to 20 %.
    let found = |s: f64| Some(evidence(truth(s)).map(|value| value / 16.0));
    drive(&mut belief, 0.0, 204.0, found);
    let [_, found, _] = quantiles(&mut belief, 204.0);
    assert!((0.35..0.5).contains(&found), "{found}");
    belief.leave();
    let [_, stored, _] = quantiles(&mut belief, 204.0);
    assert!(stored > 0.6, "{stored}");
}

#[test]
fn a_stored_belief_is_the_same_belief() {
    let mut belief = belief();
    drive(&mut belief, 0.0, 700.0, |s| {
        Some(evidence(0.3 + s / 1000.0))
    });
    belief.leave();
    let bytes = belief.to_bytes().unwrap();
    let mut again = self::belief();
    again.recall(&bytes, 0.0).unwrap();
    assert_eq!(again.to_bytes().unwrap(), bytes);
    assert_eq!(quantiles(&mut again, 333.0), quantiles(&mut belief, 333.0));
}

#[test]
fn bytes_that_are_no_belief_about_this_road_are_errors_and_change_nothing() {
    let mut stored = belief();
    drive(&mut stored, 0.0, 100.0, |_| Some(evidence(0.5)));
    let bytes = stored.to_bytes().unwrap();
    let refused = |bytes: &[u8], length: f64, closed: bool| {
        let mut other = RoadBelief::new(length, closed).unwrap();
        let before = other.to_bytes().unwrap();
        let error = other.recall(bytes, 0.0).unwrap_err().to_string();
        assert_eq!(other.to_bytes().unwrap(), before);
        error
    };
    assert!(refused(&bytes, 501.0, true).contains("about a road of 500 m (lap), this one has 501"));
    assert!(refused(&bytes, LENGTH, false).contains("(road)"));
    assert!(refused(b"no belief", LENGTH, true).contains("not a stored belief"));
    for end in [0, 8, 100, bytes.len() - 1] {
        assert!(refused(&bytes[..end], LENGTH, true).contains("not a stored belief"));
    }
    let mut spoiled = bytes.clone();
    let last = spoiled.len() - 8;
    spoiled[last..].copy_from_slice(&f64::NAN.to_le_bytes());
    assert!(refused(&spoiled, LENGTH, true).contains("NaN"));
    // A single bit that changed is found wherever it is: in the header, in the description of the road, in the evidence.
    for byte in (0..400).chain((400..bytes.len()).step_by(997)) {
        let mut flipped = bytes.clone();
        flipped[byte] ^= 1;
        refused(&flipped, LENGTH, true);
    }
}

#[test]
fn a_road_of_the_same_length_with_another_course_is_another_road() {
    let lap = |corner: f64| {
        let points = [[0.0, 0.0], [corner, 0.1], [125.0, 125.0], [0.0, 125.0]];
        belief().with_shape(points.to_vec())
    };
    let mut stored = lap(125.0);
    drive(&mut stored, 0.0, 100.0, |_| Some(evidence(0.5)));
    let bytes = stored.to_bytes().unwrap();
    lap(125.2).recall(&bytes, 0.0).unwrap();
    let told = lap(110.0).recall(&bytes, 0.0).unwrap_err().to_string();
    assert!(told.contains("another road of 500.0 m: 125 m from the start, that one is 15.0 m"));
    let told = belief().recall(&bytes, 0.0).unwrap_err().to_string();
    assert!(told.contains("expected 0 coordinates of its road, got 8"));
}

#[test]
fn numbers_out_of_range_are_errors() {
    assert!(RoadBelief::new(f64::NAN, true).is_err());
    let mut belief = belief();
    assert!(belief.update(f64::NAN, None).is_err());
    for spoiled in [f64::NAN, 0.5, f64::NEG_INFINITY, f64::MIN, -1.1e6] {
        assert!(
            belief
                .update(0.0, Some(&[spoiled; FRICTION_HYPOTHESES]))
                .is_err()
        );
    }
    for risk in [0.0, 1.0, f64::NAN] {
        assert!(belief.ahead(0.0, 1.0, risk, &mut [0.0; 3]).is_err());
        assert!(belief.quantile(0.0, risk).is_err());
    }
    assert!(belief.ahead(0.0, 0.0, 0.1, &mut [0.0; 3]).is_err());
    for far in [1.1e9, -1.1e9, f64::INFINITY, 1e300] {
        assert!(belief.update(far, None).is_err());
        assert!(belief.ahead(far, 1.0, 0.1, &mut [0.0; 3]).is_err());
        assert!(belief.quantile(far, 0.5).is_err());
    }
    assert!(belief.ahead(-1e9, 1.0, 0.1, &mut [0.0; 3]).is_ok());
    assert!(belief.ahead(0.0, 1e300, 0.1, &mut [0.0; 3]).is_err());
    assert!(belief.ahead(0.0, 5e3, 0.1, &mut [0.0; 3]).is_err());
    assert!(RoadBelief::new(1.1e6, true).is_err());
    for window in [0, 1001, usize::MAX] {
        assert!(belief.set_window(window).is_err());
    }
}

#[test]
fn the_smallest_likelihoods_exclude_coefficients() {
    let mut belief = belief();
    let mut only = [LEAST_LOG_LIKELIHOOD; FRICTION_HYPOTHESES];
    only[9] = 0.0;
    drive(&mut belief, 0.0, 30.0, |_| Some(only));
    let [mu_low, mu_high] = [8, 10].map(|i| friction_hypotheses()[i]);
    for mu in quantiles(&mut belief, 27.0) {
        assert!(mu_low < mu && mu < mu_high, "{mu}");
    }
}

#[test]
fn an_update_that_fails_changes_nothing() {
    let mut belief = belief();
    drive(&mut belief, 0.0, 30.0, |_| Some(evidence(0.3)));
    let before = quantiles(&mut belief, 29.0);
    let mut wrong = evidence(0.3);
    wrong[2] = f64::NAN;
    assert!(belief.update(30.0, Some(&wrong)).is_err());
    assert_eq!(quantiles(&mut belief, 29.0), before);
}

#[test]
fn only_ratios_of_likelihoods_count() {
    let (mut belief, mut lower) = (belief(), belief());
    let found = |shift: f64| evidence(friction_hypotheses()[8]).map(|value| value + shift);
    drive(&mut belief, 0.0, 30.0, |_| Some(found(0.0)));
    drive(&mut lower, 0.0, 30.0, |_| Some(found(-4000.0)));
    let (mut rows, mut others) = ([[0.0; 2]; 3], [[0.0; 2]; 3]);
    belief.preview(&[20.0, 30.0], &mut rows).unwrap();
    lower.preview(&[20.0, 30.0], &mut others).unwrap();
    for (value, other) in rows.iter().flatten().zip(others.iter().flatten()) {
        assert!((value - other).abs() < 1e-6, "{rows:?} {others:?}");
    }
    assert!(rows[1][1] > 0.0);
}

#[test]
fn evidence_beyond_an_end_of_an_open_road_counts_nowhere_else() {
    let mut belief = RoadBelief::new(LENGTH, false).unwrap();
    let ice = evidence(0.15);
    let unknown = belief.quantile(LENGTH - 3.0, 0.5).unwrap();
    for period in 0..40 {
        belief
            .update(-9.0 + 0.2 * f64::from(period), Some(&ice))
            .unwrap();
    }
    assert_eq!(belief.quantile(LENGTH - 3.0, 0.5).unwrap(), unknown);
    belief.leave();
    for period in 0..40 {
        let s = LENGTH + 1.0 + 0.2 * f64::from(period);
        belief.update(s, Some(&ice)).unwrap();
    }
    assert_eq!(belief.quantile(3.0, 0.5).unwrap(), unknown);
}
