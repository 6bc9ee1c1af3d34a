//! The friction over the horizon of a control step, for its model.

use crate::RoadBelief;
use crate::belief::REACH;
use crate::belief_error::{BeliefError, check, place, stretch};

impl RoadBelief {
    /// Writes rows of the friction coefficient's median and standard deviation: first the mean over the places that the
    /// vehicle passed in the window, of which the present one counts twice, then one row for each of `places`, whose arc
    /// lengths do not decrease. These are the rows of the `road_friction` of a control step, and `out` has one more of them than there are places.
    ///
    /// In contrast to [`Self::ahead`], patches are not considered.
    ///
    /// # Errors
    /// [`BeliefError`] unless the places are arc lengths that do not decrease, `out` has the right number of rows, and the road
    /// from the oldest place of the window to the last of the places is at most 10 km long.
    pub fn preview(&mut self, places: &[f64], out: &mut [[f64; 2]]) -> Result<(), BeliefError> {
        let [start, .., end] = *places else {
            let count = places.len() as f64;
            return check("the number of places", count, "at least 2", |_| false);
        };
        place("places", start)?;
        let rows = places.len() as f64 + 1.0;
        check(
            "the number of rows",
            out.len() as f64,
            "one more than places",
            |v| v == rows,
        )?;
        for pair in places.windows(2) {
            check("places", pair[1], "arc lengths that do not decrease", |v| {
                v >= pair[0]
            })?;
        }
        let oldest = self.near(self.track.front().copied().unwrap_or(start), start);
        stretch(
            "the road from the oldest place of the window to the last of places",
            end - oldest.min(start),
        )?;
        let first = self.index(oldest.min(start));
        let masses = self.masses(first, self.index(end), REACH, 0.0);
        let moments: Vec<[f64; 2]> = (masses.iter())
            .map(|masses| self.grid.median_and_std(masses))
            .collect();
        let at = |s: f64| moments[(self.index(s) - first) as usize];
        for (row, s) in out[1..].iter_mut().zip(places) {
            *row = at(*s);
        }
        let (mut sum, mut count) = (at(start), 1.0);
        for s in self.track.iter().map(|s| self.near(*s, start)) {
            if (oldest..=start).contains(&s) {
                let here = at(s);
                sum = [sum[0] + here[0], sum[1] + here[1]];
                count += 1.0;
            }
        }
        out[0] = sum.map(|value| value / count);
        Ok(())
    }

    /// The arc length of a place near `here`, counted without a jump at the end of a lap: on a lap it differs from `here` by at
    /// most half of the length.
    pub(crate) fn near(&self, s: f64, here: f64) -> f64 {
        if !self.closed() {
            return s;
        }
        let length = self.length();
        s - length * ((s - here) / length).round()
    }
}
