//! What other vehicles report: merging, ageing, and whether it describes the road.

use egp_map::{MergeSettings, RoadBelief, TILE_BYTES, TILE_CELLS, Tile, merge};
use egp_parameters::{FRICTION_HYPOTHESES, friction_hypotheses};

/// One tile.
const LENGTH: f64 = 2.0 * TILE_CELLS as f64;
const PERIOD: f64 = 0.02;
const SPEED: f64 = 10.0;

fn belief() -> RoadBelief {
    RoadBelief::new(LENGTH, true).unwrap()
}

fn evidence(mu: f64) -> [f64; FRICTION_HYPOTHESES] {
    let rows = friction_hypotheses().map(|h| -0.5 * ((h / mu).ln() / 0.08).powi(2));
    let most = rows.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    rows.map(|value| value - most)
}

/// Drives for `time` s from `start` on over a road of friction `mu`; the first window needs 0.5 s.
fn drive(belief: &mut RoadBelief, start: f64, time: f64, mu: f64) {
    for period in 0..(time / PERIOD).round() as usize {
        let s = start + SPEED * PERIOD * period as f64;
        belief
            .update(s.rem_euclid(LENGTH), Some(&evidence(mu)))
            .unwrap();
    }
}

/// What a vehicle contributes that found the friction `mu` everywhere.
fn found(mu: f64) -> Tile {
    let mut belief = belief();
    drive(&mut belief, 0.0, 10.0 * LENGTH / SPEED, mu);
    belief.tile(0).unwrap()
}

/// The median friction in the middle of the road that a vehicle reckons with that measured nothing itself.
fn median(tile: &Tile) -> f64 {
    let mut belief = belief();
    belief.report(0, tile).unwrap();
    belief.quantile(0.5 * LENGTH, 0.5).unwrap()
}

/// The largest ratio of likelihoods in a cell, in nats.
fn largest(tile: &Tile) -> f64 {
    f64::from(*tile.bytes().iter().max().unwrap()) / 32.0
}

fn merged(contributions: &[(&Tile, f64)]) -> Tile {
    merge(contributions.iter().copied(), &MergeSettings::default())
}

#[test]
fn reports_change_plans_and_are_never_published_as_own_evidence() {
    let mut told = belief();
    let (empty, stored) = (told.tile(0).unwrap(), told.to_bytes().unwrap());
    let mut friction = [0.0; 2];
    told.ahead(60.0, 1.0, 0.05, &mut friction).unwrap();
    let before = friction[0];
    told.report(0, &found(0.9)).unwrap();
    drive(&mut told, 0.0, 0.6, 0.9);
    told.ahead(60.0, 1.0, 0.05, &mut friction).unwrap();
    assert!(before < 0.2 && friction[0] > 0.7, "{before} {friction:?}");

    let mut silent = belief();
    silent.report(0, &found(0.9)).unwrap();
    assert_eq!(silent.tile(0).unwrap(), empty);
    assert_eq!(silent.to_bytes().unwrap(), stored);
    assert!(silent.take_changed().is_empty());
    drive(&mut silent, 0.0, 0.6, 0.9);
    assert_eq!(silent.take_changed(), [0]);
    assert!(silent.take_changed().is_empty());
}

#[test]
fn one_vehicle_has_bounded_influence() {
    let loud = Tile::from_bytes(&[[255; 48].as_slice(), &[0]].concat().repeat(TILE_CELLS)).unwrap();
    assert!(largest(&loud) > 7.9);
    let capacity = MergeSettings::default().capacity;
    assert!((largest(&merged(&[(&loud, 0.0)])) - capacity).abs() < 0.02);
    let honest = found(0.5);
    let change = (0..TILE_BYTES).map(|i| {
        let [with, without] = [
            merged(&[(&honest, 0.0), (&loud, 0.0)]),
            merged(&[(&honest, 0.0)]),
        ];
        f64::from(with.bytes()[i].abs_diff(without.bytes()[i])) / 32.0
    });
    assert!(change.take(49).fold(0.0, f64::max) <= capacity + 0.04);
}

#[test]
fn two_vehicles_outvote_a_third() {
    for (honest, lie) in [(0.4, 1.1), (0.9, 0.25), (0.6, 0.8)] {
        let (honest_tile, lie_tile) = (found(honest), found(lie));
        let outvoted = merged(&[(&lie_tile, 0.0), (&honest_tile, 0.0), (&honest_tile, 9.0)]);
        assert!(
            (median(&outvoted) / honest).ln().abs() < 0.1,
            "{honest} {lie}: {}",
            median(&outvoted)
        );
        let alone = merged(&[(&lie_tile, 0.0)]);
        assert!((median(&alone) / lie).ln().abs() < 0.1);
    }
}

#[test]
fn a_minority_excludes_no_friction() {
    // Careful vehicles found at least 0.5; a liar says exactly 1.1.
    let careful = {
        let mut belief = belief();
        let bound = friction_hypotheses().map(|mu| if mu < 0.5 { -4.0 } else { 0.0 });
        for period in 0..6400 {
            belief
                .update((0.2 * f64::from(period)).rem_euclid(LENGTH), Some(&bound))
                .unwrap();
        }
        belief.tile(0).unwrap()
    };
    let lie = found(1.1);
    let outvoted = merged(&[(&lie, 0.0), (&careful, 0.0), (&careful, 0.0)]);
    let mut believed = belief();
    believed.report(0, &outvoted).unwrap();
    assert!(believed.quantile(0.5 * LENGTH, 0.2).unwrap() < 0.75);
    // With one careful vehicle only, nobody has a majority and all evidence counts.
    let divided = merged(&[(&lie, 0.0), (&careful, 0.0)]);
    assert!(median(&divided) > 1.0);
}

#[test]
fn evidence_ages_towards_the_prior() {
    let tile = found(0.5);
    let lifetime = MergeSettings::default().lifetime;
    let strengths =
        [0.0, 0.5, 1.0, 2.0].map(|lives| largest(&merged(&[(&tile, lives * lifetime)])));
    for (strength, lives) in strengths.iter().zip([0.0, 0.5, 1.0, 2.0_f64]) {
        assert!(
            (strength - strengths[0] * (-lives).exp()).abs() < 0.04,
            "{strengths:?}"
        );
    }
    let longest = MergeSettings::default().longest_age();
    assert!(!merged(&[(&tile, 0.99 * longest)]).is_empty());
    assert!(merged(&[(&tile, 1.01 * longest)]).is_empty());
    assert_eq!(merged(&[(&tile, -5.0)]), merged(&[(&tile, 0.0)]));
    // Of two that contradict each other, the newer one counts more.
    assert!(median(&merged(&[(&tile, lifetime), (&found(0.9), 0.0)])) > 0.8);
}

#[test]
fn stored_evidence_ages_like_reports() {
    let mut driven = belief();
    drive(&mut driven, 0.0, 10.0 * LENGTH / SPEED, 0.5);
    let stored = driven.to_bytes().unwrap();
    let lifetime = MergeSettings::default().lifetime;
    for age in [0.0, lifetime, 20.0 * lifetime] {
        let mut recalled = belief();
        recalled.recall(&stored, age).unwrap();
        let reported = merged(&[(&driven.tile(0).unwrap(), age)]);
        let recalled = strength(&recalled.to_bytes().unwrap());
        assert!((recalled - largest(&reported)).abs() < 0.04, "{age}");
    }
}

/// The largest ratio of likelihoods in the bytes of a stored belief, in nats.
fn strength(stored: &[u8]) -> f64 {
    let (header, rest) = stored.split_first_chunk().unwrap();
    let values = rest[u64::from_le_bytes(*header) as usize..].as_chunks().0;
    let least = values.iter().copied().map(f64::from_le_bytes);
    -least.fold(0.0, f64::min)
}

#[test]
fn what_was_recalled_is_used_and_not_given_to_others() {
    let mut driven = belief();
    drive(&mut driven, 0.0, 10.0 * LENGTH / SPEED, 0.3);
    let (mut later, mut without) = (belief(), belief());
    later.recall(&driven.to_bytes().unwrap(), 0.0).unwrap();
    assert!(later.quantile(0.5 * LENGTH, 0.5).unwrap() < 0.35);
    assert!(later.take_changed().is_empty() && later.tile(0).unwrap().is_empty());
    for belief in [&mut later, &mut without] {
        drive(belief, 0.0, 1.0, 0.3);
    }
    assert_eq!(later.take_changed(), [0]);
    assert_eq!(later.tile(0).unwrap(), without.tile(0).unwrap());
}

#[test]
fn the_order_does_not_matter() {
    let tiles = [found(0.3), found(0.5), found(0.9), found(1.1)];
    let ages = [0.0, 100.0, 1000.0, 4000.0];
    let all: Vec<(&Tile, f64)> = tiles.iter().zip(ages).collect();
    let once = merged(&all);
    for shift in 0..all.len() {
        let mut other = all.clone();
        other.rotate_left(shift);
        other.swap(0, 2);
        assert_eq!(merged(&other), once);
    }
    assert!(merged(&[]).is_empty());
}

#[test]
fn what_is_measured_wins_within_half_a_second() {
    for (road, reported) in [(0.4, 1.1), (0.3, 0.6), (0.5, 0.9)] {
        let mut belief = belief();
        belief.report(0, &found(reported)).unwrap();
        // The road is as reported at first, so that the reports are trusted as much as possible.
        drive(&mut belief, 0.0, 5.0, reported);
        assert!(belief.trust().unwrap() > 0.98);
        // The windows are of the new surface from here on.
        drive(&mut belief, 50.0, 0.5 + PERIOD, road);
        let mut friction = [0.0; 40];
        belief.ahead(55.0, 1.0, 0.05, &mut friction).unwrap();
        let most = friction.iter().copied().fold(0.0, f64::max);
        assert!(
            most < 1.1 * road,
            "{road} {reported}: {most} trust {:?}",
            belief.trust()
        );
    }
}

#[test]
fn trust_follows_what_is_measured() {
    let mut belief = belief();
    assert_eq!(belief.trust(), None);
    belief.report(0, &found(0.6)).unwrap();
    let at_first = belief.trust().unwrap();
    drive(&mut belief, 0.0, 3.0, 0.6);
    let confirmed = belief.trust().unwrap();
    drive(&mut belief, 30.0, 3.0, 0.3);
    let contradicted = belief.trust().unwrap();
    drive(&mut belief, 60.0, 6.0, 0.6);
    let again = belief.trust().unwrap();
    assert!(
        (at_first - 0.5).abs() < 1e-9 && confirmed > 0.98,
        "{at_first} {confirmed}"
    );
    assert!(contradicted < 0.02 && again > 0.9, "{contradicted} {again}");
    // More friction than reported contradicts less than no friction: a careful vehicle finds a lower bound.
    let mut better = self::belief();
    better.report(0, &found(0.6)).unwrap();
    drive(&mut better, 0.0, 1.0, 0.9);
    assert!(better.trust().unwrap() > 0.2);
}

#[test]
fn windows_of_an_earlier_length_count_by_it() {
    let mut belief = belief();
    belief.report(0, &found(0.5)).unwrap();
    let mut s = 0.0;
    let mut update = |belief: &mut RoadBelief, found: Option<[f64; FRICTION_HYPOTHESES]>| {
        s += 0.2;
        belief.update(s, found.as_ref()).unwrap();
    };
    for period in 0..36 {
        update(&mut belief, (period > 25).then(|| evidence(0.5)));
    }
    belief.set_window(5).unwrap();
    let trust = belief.trust().unwrap();
    assert!((0.52..0.92).contains(&trust), "{trust}");
    // These windows contain no information.
    for _ in 0..40 {
        update(&mut belief, Some([0.0; FRICTION_HYPOTHESES]));
    }
    assert_eq!(belief.trust(), Some(trust));
}

#[test]
fn windows_before_the_vehicle_was_moved_are_not_forgotten() {
    let mut belief = belief();
    belief.report(0, &found(1.1)).unwrap();
    drive(&mut belief, 0.0, 3.0, 0.3);
    let contradicted = belief.trust().unwrap();
    assert!(contradicted < 0.02, "{contradicted}");
    belief.leave();
    let none = Some([0.0; FRICTION_HYPOTHESES]);
    for period in 0..60 {
        belief
            .update(30.0 + 0.2 * f64::from(period), none.as_ref())
            .unwrap();
        let trust = belief.trust().unwrap();
        assert!(trust < 0.03, "{period}: {trust}");
    }
}

#[test]
fn tiles_read_back_and_other_bytes_are_errors() {
    let tile = found(0.7);
    assert_eq!(Tile::from_bytes(tile.bytes()).unwrap(), tile);
    let shifted: Vec<u8> = tile
        .bytes()
        .iter()
        .map(|byte| byte.saturating_add(3))
        .collect();
    assert_eq!(
        Tile::from_bytes(&shifted).unwrap().bytes()[..49]
            .iter()
            .min(),
        Some(&0)
    );
    for bytes in [&tile.bytes()[1..], &[tile.bytes(), &[0]].concat(), &[]] {
        let message = Tile::from_bytes(bytes).unwrap_err().to_string();
        assert!(
            message.contains("expected a tile of 3136 bytes"),
            "{message}"
        );
    }
    let message = belief().report(1, &tile).unwrap_err().to_string();
    assert_eq!(message, "expected a tile in 0..1 of this road, got 1");
    assert!(belief().tile(7).is_err());
}

#[test]
fn what_is_measured_where_nothing_was_reported_does_not_change_the_trust() {
    const REPORTED: usize = 10;
    for mu in [0.2, 0.3, 0.5, 0.9, 1.1] {
        let mut belief = RoadBelief::new(20.0 * LENGTH, true).unwrap();
        belief.report(REPORTED, &found(0.8)).unwrap();
        let before = belief.trust().unwrap();
        for period in 0..300 {
            let s = 200.0 + SPEED * PERIOD * f64::from(period);
            belief.update(s, Some(&evidence(mu))).unwrap();
        }
        let after = belief.trust().unwrap();
        assert!((after - before).abs() < 1e-9, "{mu}: {before} {after}");
    }
}
