//! Beliefs about roads of small vehicles.

use egp_map::RoadBelief;

use super::{LENGTH, belief, evidence};

/// A power of two, so that lengths of both roads differ by no rounding.
const SCALE: f64 = 0.125;

fn small() -> RoadBelief {
    let belief = RoadBelief::new(SCALE * LENGTH, true).unwrap();
    belief.with_scale(SCALE).unwrap()
}

/// What is planned for after most of a lap with two surfaces, at places along it.
fn planned(mut belief: RoadBelief, scale: f64) -> Vec<f64> {
    let step = 0.2 * scale;
    for period in 0..1900 {
        let s = step * f64::from(period);
        let mu = if s < 200.0 * scale { 0.9 } else { 0.4 };
        belief.update(s, Some(&evidence(mu))).unwrap();
    }
    let mut friction = vec![0.0; 250];
    let start = step * 1900.0;
    belief
        .ahead(start, 2.0 * scale, 0.05, &mut friction)
        .unwrap();
    let mut preview = vec![[0.0; 2]; 41];
    let places: Vec<f64> = (0..40).map(|i| start + scale * f64::from(i)).collect();
    belief.preview(&places, &mut preview).unwrap();
    friction.extend(preview.as_flattened());
    friction
}

#[test]
fn a_small_road_is_known_like_a_large_one_of_the_same_shape() {
    assert_eq!(planned(small(), SCALE), planned(belief(), 1.0));
}

#[test]
fn a_vehicle_that_was_moved_on_a_small_road_is_noticed_at_a_shorter_distance() {
    let mut belief = small();
    for period in 0..40 {
        belief
            .update(0.025 * f64::from(period), Some(&evidence(0.4)))
            .unwrap();
    }
    belief.update(21.0, Some(&evidence(0.9))).unwrap();
    let mut preview = [[0.0; 2]; 3];
    belief.preview(&[21.0, 21.1], &mut preview).unwrap();
    assert_eq!(preview[0], preview[1], "the window begins anew");
}

#[test]
fn beliefs_of_another_scale_exchange_no_files_and_say_so() {
    let stored = small().to_bytes().unwrap();
    let mut other = RoadBelief::new(SCALE * LENGTH, true).unwrap();
    let told = other.recall(&stored, 0.0).unwrap_err().to_string();
    assert!(told.contains("another scale"), "{told}");
    small().recall(&stored, 0.0).unwrap();
}

#[test]
fn a_scale_that_is_none_is_an_error() {
    for scale in [0.0, -1.0, 1.5, f64::NAN] {
        let told = belief().with_scale(scale).unwrap_err().to_string();
        assert!(told.contains("scale"), "{told}");
    }
    assert!((small().longest_cell() - 0.25).abs() < 1e-15);
}

#[test]
fn scales_whose_cells_have_as_many_millimetres_have_the_same_cells() {
    let road = |scale: f64| {
        RoadBelief::new(100.0, false)
            .unwrap()
            .with_scale(scale)
            .unwrap()
    };
    let cells = |scale: f64| (road(scale).scale(), road(scale).to_bytes().unwrap());
    assert_eq!(cells(0.1), cells(0.1002));
    assert_ne!(cells(0.1), cells(0.1004));
    assert_eq!(road(0.1004).scale(), 0.1005);
}

#[test]
fn a_road_has_at_most_as_many_cells_as_one_of_1000_km_at_full_size() {
    let longest = |length: f64| RoadBelief::new(length, false).unwrap().with_scale(0.01);
    let told = longest(11e3).unwrap_err().to_string();
    assert!(told.contains("1e6 m times the scale for length"), "{told}");
    assert_eq!(longest(10e3).unwrap().tiles(), 7813);
}

#[test]
fn another_scale_makes_a_belief_without_what_was_recalled() {
    let stored = belief().to_bytes().unwrap();
    let mut scaled = belief();
    scaled.set_window(2).unwrap();
    scaled.recall(&stored, 0.0).unwrap();
    let mut scaled = scaled.with_scale(SCALE).unwrap();
    assert_eq!(scaled.window(), 2);
    for s in [496.0, 497.0, 498.0, 499.0] {
        scaled.update(s, Some(&evidence(0.4))).unwrap();
    }
    assert_ne!(scaled.quantile(497.0, 0.5), belief().quantile(497.0, 0.5));
}
