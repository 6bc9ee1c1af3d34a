//! The posterior from the vehicle's own evidence and from what others reported.

use crate::RoadBelief;
use crate::grid::{Row, combine, mix, multiply, to_probabilities};
use crate::patch::{PATCH, products};
use crate::reported::Reported;

/// The evidence that a posterior uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Layer {
    /// What the vehicle measured.
    Own,
    /// What others reported.
    Reported,
    /// Both.
    Both,
}

impl RoadBelief {
    /// Rows proportional to the probabilities of the coefficients in the cells `first..=last`, where each cell belongs to a
    /// patch with the probability `patch`. A patch's friction is drawn from the prior. What was measured within 8 m of the cell
    /// is evidence about it, and what was measured farther away is not.
    ///
    /// With reports it is a mixture: with the probability that they describe the road they count like the vehicle's own
    /// evidence, otherwise only the latter counts.
    pub(crate) fn masses(&mut self, first: i64, last: i64, reach: f64, patch: f64) -> Vec<Row> {
        let mut own = self.masses_of(Layer::Own, first, last, reach, patch);
        let Some(trust) = self.reported.as_ref().map(Reported::trust) else {
            return own;
        };
        let both = self.masses_of(Layer::Both, first, last, reach, patch);
        for (own, mut both) in own.iter_mut().zip(both) {
            to_probabilities(own);
            to_probabilities(&mut both);
            combine(own, &both, |own, both| own + trust * (both - own));
        }
        own
    }

    /// The rows of [`Self::masses`] from one layer's evidence alone.
    pub(crate) fn masses_of(
        &mut self,
        layer: Layer,
        first: i64,
        last: i64,
        reach: f64,
        patch: f64,
    ) -> Vec<Row> {
        let (reach, at_once) = self.reach(reach);
        let mut found = Vec::new();
        let mut start = first;
        while start <= last {
            let end = last.min(start.saturating_add(at_once - 1));
            let part = self.masses_at_once(layer, start, end, reach, patch);
            if found.is_empty() {
                found = part;
            } else {
                found.extend(part);
            }
            start = end + 1;
        }
        found
    }

    /// The rows of [`Self::masses_of`] for cells whose messages may be computed at once, from evidence up to `reach` cells
    /// beyond them.
    fn masses_at_once(
        &mut self,
        layer: Layer,
        first: i64,
        last: i64,
        reach: i64,
        patch: f64,
    ) -> Vec<Row> {
        self.smooth(layer, first, last, reach);
        let cells = (last - first + 1) as usize;
        let side = if patch > 0.0 {
            self.within(self.cells_of(PATCH).round())
        } else {
            0
        };
        let mut likelihoods = Vec::with_capacity(cells + 2 * side as usize);
        for index in first - side..=last + side {
            let mut likelihood = [1.0; _];
            self.weigh(layer, index, &mut likelihood);
            likelihoods.push(likelihood);
        }
        let own = likelihoods.iter().skip(side as usize);
        let mut found = Vec::with_capacity(cells);
        for ((forward, likelihood), backward) in
            self.forward.iter().zip(own).zip(&self.backward).take(cells)
        {
            let mut masses = *forward;
            multiply(&mut masses, likelihood);
            multiply(&mut masses, backward);
            found.push(masses);
        }
        if patch > 0.0 {
            let window = 2 * side as usize + 1;
            let nearby = products(&likelihoods, window);
            for (masses, nearby) in found.iter_mut().zip(&nearby[window - 1..]) {
                mix(masses, nearby, &self.grid.prior, patch);
            }
        }
        found
    }

    /// Multiplies `row` by a layer's likelihoods in a cell. Cells beyond the ends of an open road have no evidence.
    pub(crate) fn weigh(&self, layer: Layer, index: i64, row: &mut Row) {
        let Some(cell) = self.stored(index) else {
            return;
        };
        if layer != Layer::Reported {
            multiply(row, &self.likelihood[cell]);
            if let Some(recent) = self.recent.as_ref().and_then(|recent| recent.at(cell)) {
                multiply(row, recent);
            }
        }
        if layer != Layer::Own
            && let Some(reported) = &self.reported
        {
            multiply(row, &reported.likelihood[cell]);
        }
    }
}
