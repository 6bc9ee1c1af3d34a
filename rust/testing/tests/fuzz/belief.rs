//! Stored beliefs about roads.

use egp_map::{MergeSettings, RoadBelief, TILE_BYTES, Tile, merge};
use egp_parameters::friction_hypotheses;

use crate::edits::Words;
use crate::fuzz;

fn road() -> RoadBelief {
    RoadBelief::new(20.0, true).unwrap()
}

/// A belief with evidence in most of its cells.
fn example() -> Vec<u8> {
    let mut belief = road();
    let evidence = friction_hypotheses().map(|mu| -0.5 * ((mu / 0.5).ln() / 0.2).powi(2));
    for period in 0..80 {
        belief
            .update(0.2 * f64::from(period), Some(&evidence))
            .unwrap();
    }
    belief.to_bytes().unwrap()
}

#[test]
fn what_is_recalled_can_be_planned_for() {
    fuzz!([example()], Words::Doubles, |bytes: Vec<u8>| {
        let mut belief = road();
        let before = belief.to_bytes().unwrap();
        if belief.recall(&bytes, 0.0).is_err() {
            assert_eq!(belief.to_bytes().unwrap(), before);
            return;
        }
        let mut friction = [0.0; 25];
        belief.ahead(0.0, 1.0, 0.05, &mut friction).unwrap();
        assert!(
            friction.iter().all(|mu| (0.1..=1.3).contains(mu)),
            "{friction:?}"
        );
    });
}

#[test]
fn an_accepted_tile_can_be_merged_and_reported() {
    let mut belief = road();
    belief.recall(&example(), 0.0).unwrap();
    let tile = belief.tile(0).unwrap();
    fuzz!([tile.bytes().to_vec()], Words::Doubles, |bytes: Vec<u8>| {
        let Ok(tile) = Tile::from_bytes(&bytes) else {
            assert_ne!(bytes.len(), TILE_BYTES);
            return;
        };
        assert_eq!(Tile::from_bytes(tile.bytes()).unwrap(), tile);
        let settings = MergeSettings::default();
        let merged = merge([(&tile, 5.0), (&tile, 1e9)], &settings);
        assert!(
            merged
                .bytes()
                .iter()
                .all(|byte| f64::from(*byte) / 32.0 <= settings.capacity + 0.02)
        );
        let mut belief = road();
        belief.report(0, &merged).unwrap();
        let mut friction = [0.0; 25];
        belief.ahead(0.0, 1.0, 0.05, &mut friction).unwrap();
        assert!(friction.iter().all(|mu| (0.1..=1.3).contains(mu)));
    });
}
