//! Quantiles of the friction: those for a speed plan, and those at one place.

use crate::RoadBelief;
use crate::belief::{BLUR, CHANGE_DISTANCE, COMMITMENT, REACH};
use crate::belief_error::{BeliefError, place, positive, probability, stretch};

impl RoadBelief {
    /// Writes the friction to plan for at places `step` m apart from `start` on: the coefficient below which the
    /// friction lies with the probability `risk`, where each place may be on a patch.
    ///
    /// # Errors
    /// [`BeliefError`] unless `start` is an arc length within ±1e9 m, the places cover at most 10 km, and `risk` is in (0, 1).
    pub fn ahead(
        &mut self,
        start: f64,
        step: f64,
        risk: f64,
        friction: &mut [f64],
    ) -> Result<(), BeliefError> {
        place("start", start)?;
        positive("step", step)?;
        stretch(
            "step times the number of places",
            step * friction.len() as f64,
        )?;
        probability("risk", risk)?;
        let blur = self.cells_of(BLUR).round() as i64;
        let first = self.index(start) - blur;
        let last = self.index(start + step * friction.len().saturating_sub(1) as f64) + blur;
        let patch = 1.0 - (-COMMITMENT / CHANGE_DISTANCE).exp();
        let cells: Vec<f64> = (self.masses(first, last, REACH, patch).iter())
            .map(|masses| self.grid.quantile(masses, risk))
            .collect();
        for (i, out) in friction.iter_mut().enumerate() {
            let centre = (self.index(start + step * i as f64) - first - blur) as usize;
            let near = &cells[centre..=centre + 2 * blur as usize];
            *out = near.iter().copied().fold(f64::INFINITY, f64::min);
        }
        Ok(())
    }

    /// The friction below which that at `s` lies with the probability `share`, without regard to patches.
    ///
    /// # Errors
    /// [`BeliefError`] unless `s` is an arc length within ±1e9 m and `share` in (0, 1).
    pub fn quantile(&mut self, s: f64, share: f64) -> Result<f64, BeliefError> {
        probability("share", share)?;
        place("s", s)?;
        let index = self.index(s);
        let reach = 3.0 * CHANGE_DISTANCE;
        let masses = self.masses(index, index, reach, 0.0);
        Ok(self.grid.quantile(&masses[0], share))
    }
}
