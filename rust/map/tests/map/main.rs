//! Beliefs about roads of known friction.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]

mod belief;
mod fleet;
mod preview;
mod scale;

use egp_map::RoadBelief;
use egp_parameters::{FRICTION_HYPOTHESES, friction_hypotheses};

const LENGTH: f64 = 500.0;

fn belief() -> RoadBelief {
    RoadBelief::new(LENGTH, true).unwrap()
}

/// Evidence for a friction coefficient that is known to 5 %.
fn evidence(mu: f64) -> [f64; FRICTION_HYPOTHESES] {
    friction_hypotheses().map(|hypothesis| -0.5 * ((hypothesis / mu).ln() / 0.05).powi(2))
}

/// Drives from `from` to `to` at 10 m/s; `found` gives the evidence at a place.
fn drive(
    belief: &mut RoadBelief,
    from: f64,
    to: f64,
    found: impl Fn(f64) -> Option<[f64; FRICTION_HYPOTHESES]>,
) {
    let periods = ((to - from) / 0.2) as usize;
    for period in 0..periods {
        let s = from + 0.2 * period as f64;
        // The window covers the last 5 m.
        let evidence = found((s - 2.5).rem_euclid(LENGTH));
        belief
            .update(s.rem_euclid(LENGTH), evidence.as_ref())
            .unwrap();
    }
}

fn quantiles(belief: &mut RoadBelief, s: f64) -> [f64; 3] {
    [0.05, 0.5, 0.95].map(|share| belief.quantile(s, share).unwrap())
}
