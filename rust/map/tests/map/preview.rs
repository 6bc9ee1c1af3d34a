//! Previews and plans along a road, over the end of a lap and on short laps.

use egp_map::RoadBelief;

use super::{LENGTH, belief, drive, evidence};

#[test]
fn a_vehicle_that_rolls_back_over_the_start_line_adds_nothing() {
    // A lap of 12 km is longer than a preview may be.
    for length in [LENGTH, 12_000.0] {
        let mut belief = RoadBelief::new(length, true).unwrap();
        let empty = belief.to_bytes().unwrap();
        let mut rows = [[0.0; 2]; 3];
        for period in 0..60 {
            let s = (1.0 - 0.05 * f64::from(period)).rem_euclid(length);
            belief.update(s, Some(&evidence(0.2))).unwrap();
            belief.preview(&[s, s + 2.0], &mut rows).unwrap();
            assert!((rows[2][0] - 0.7).abs() < 0.01, "{rows:?}");
        }
        assert!(belief.take_changed().is_empty());
        assert_eq!(belief.to_bytes().unwrap(), empty);
    }
}

#[test]
fn evidence_about_a_patch_counts_once_on_a_lap_of_its_length() {
    let planned = |length: f64, closed: bool| {
        let mut belief = RoadBelief::new(length, closed).unwrap();
        for period in 0..50 {
            let found = evidence(0.8).map(|value| value / 60.0);
            belief
                .update(0.2 * f64::from(period), Some(&found))
                .unwrap();
        }
        belief.leave();
        let mut friction = [0.0];
        belief.ahead(5.0, 1.0, 0.05, &mut friction).unwrap();
        friction[0]
    };
    let (on_road, on_lap) = (planned(10.0, false), planned(10.0, true));
    assert!((on_lap / on_road - 1.0).abs() < 0.02, "{on_road} {on_lap}");
}

#[test]
fn no_evidence_counts_twice_on_a_short_lap() {
    // The same weak evidence about 18 m; what lies ahead of them is unknown.
    let planned = |length: f64, closed: bool, friction: &mut [f64]| {
        let mut belief = RoadBelief::new(length, closed).unwrap();
        for period in 0..90 {
            let found = evidence(0.8).map(|value| value / 60.0);
            let s = 5.0 + 0.2 * f64::from(period);
            belief.update(s, Some(&found)).unwrap();
        }
        belief.leave();
        belief.ahead(20.0, 1.0, 0.05, friction).unwrap();
        friction[0]
    };
    let on_road = planned(LENGTH, false, &mut [0.0; 250]);
    for length in [377.0, 314.0, 157.0, 94.0] {
        let on_lap = planned(length, true, &mut [0.0; 250]);
        let nearest = planned(length, true, &mut [0.0; 2]);
        // The surface behind the unknown stretch is that before it, which makes other surfaces less likely.
        let most = 1.1 * on_road;
        assert!(
            (on_road..most).contains(&on_lap) && (on_road..most).contains(&nearest),
            "{length}: {on_road} {on_lap} {nearest}"
        );
    }
}

#[test]
fn a_vehicle_that_was_moved_has_a_preview_at_once() {
    let mut belief = RoadBelief::new(50_000.0, false).unwrap();
    drive(&mut belief, 0.0, 10.0, |_| Some(evidence(0.5)));
    belief.update(20_000.0, Some(&evidence(0.5))).unwrap();
    let mut rows = [[0.0; 2]; 3];
    belief.preview(&[20_000.0, 20_002.0], &mut rows).unwrap();
    assert!((rows[1][0] - 0.675).abs() < 0.1, "not measured: {rows:?}");
}

#[test]
fn a_preview_shows_a_known_border() {
    let mut belief = belief();
    let truth = |s: f64| if s < 200.0 { 0.9 } else { 0.4 };
    drive(&mut belief, 0.0, 400.0, |s| Some(evidence(truth(s))));
    belief.leave();
    drive(&mut belief, 180.0, 190.0, |s| Some(evidence(truth(s))));
    let places: Vec<f64> = (0..20).map(|i| 190.0 + f64::from(i)).collect();
    let mut rows = vec![[0.0; 2]; 21];
    belief.preview(&places, &mut rows).unwrap();
    assert!((rows[0][0] - 0.9).abs() < 0.05, "{:?}", rows[0]);
    for ([friction, std], s) in rows[1..].iter().zip(&places) {
        if (s - 200.0).abs() > 4.0 {
            assert!((friction - truth(*s)).abs() < 0.05, "{s} {friction}");
            assert!(*std < 0.1, "{s} {std}");
        }
    }
}

#[test]
fn without_evidence_a_preview_shows_no_change() {
    let mut rows = [[0.0; 2]; 4];
    belief().preview(&[495.0, 499.0, 505.0], &mut rows).unwrap();
    for [friction, std] in rows {
        assert!((friction - 0.7).abs() < 0.01);
        assert!((std - 1.2 / 12.0_f64.sqrt()).abs() < 0.01);
    }
}

#[test]
fn a_preview_continues_across_the_end_of_a_lap() {
    let mut belief = belief();
    drive(&mut belief, 480.0, 504.0, |_| Some(evidence(0.5)));
    let mut rows = [[0.0; 2]; 3];
    belief.preview(&[4.0, 6.0], &mut rows).unwrap();
    assert!(
        (rows[0][0] - 0.5).abs() < 0.1 && (rows[1][0] - 0.5).abs() < 0.1,
        "{rows:?}"
    );
}

#[test]
fn places_of_a_preview_are_checked() {
    let mut belief = belief();
    let mut check =
        |places: &[f64], rows: usize| belief.preview(places, &mut vec![[0.0; 2]; rows]).is_err();
    assert!(!check(&[1.0, 2.0], 3));
    assert!(check(&[1.0, 2.0], 2) && check(&[1.0], 2) && check(&[], 1));
    assert!(check(&[2.0, 1.0], 3) && check(&[f64::NAN, 1.0], 3) && check(&[1.0, f64::NAN], 3));
    assert!(check(&[0.0, 2e4], 3));
}
