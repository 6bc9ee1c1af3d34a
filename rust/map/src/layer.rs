//! The posterior from the vehicle's own evidence and from what others reported.

use crate::RoadBelief;
use crate::grid::{Row, combine, multiply, to_probabilities};
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
    /// Rows proportional to the probabilities of the coefficients in the cells `first..=last`, after a further change of the
    /// surface with the probability `committed`.
    ///
    /// With reports it is a mixture: with the probability that they describe the road they count like the vehicle's own
    /// evidence, otherwise only the latter counts.
    pub(crate) fn masses(&mut self, first: i64, last: i64, reach: f64, committed: f64) -> Vec<Row> {
        let mut own = self.masses_of(Layer::Own, first, last, reach, committed);
        let Some(trust) = self.reported.as_ref().map(Reported::trust) else {
            return own;
        };
        let both = self.masses_of(Layer::Both, first, last, reach, committed);
        for (own, mut both) in own.iter_mut().zip(both) {
            to_probabilities(own);
            to_probabilities(&mut both);
            combine(own, &both, |own, both| own + trust * (both - own));
        }
        own
    }

    /// The same from one layer's evidence.
    pub(crate) fn masses_of(
        &mut self,
        layer: Layer,
        first: i64,
        last: i64,
        reach: f64,
        committed: f64,
    ) -> Vec<Row> {
        let (reach, at_once) = self.reach(reach);
        let mut found = Vec::new();
        let mut start = first;
        while start <= last {
            let end = last.min(start.saturating_add(at_once - 1));
            let part = self.masses_at_once(layer, start, end, reach, committed);
            if found.is_empty() {
                found = part;
            } else {
                found.extend(part);
            }
            start = end + 1;
        }
        found
    }

    /// The same for cells whose messages may be computed at once, from evidence up to `reach` cells beyond them.
    fn masses_at_once(
        &mut self,
        layer: Layer,
        first: i64,
        last: i64,
        reach: i64,
        committed: f64,
    ) -> Vec<Row> {
        self.smooth(layer, first, last, reach);
        let prior = &self.grid.prior;
        let messages = self.forward.iter().zip(&self.backward);
        (first..=last)
            .zip(messages)
            .map(|(index, (forward, backward))| {
                let mut masses = *forward;
                combine(&mut masses, prior, |mass, prior| {
                    mass + committed * (prior - mass)
                });
                self.weigh(layer, index, &mut masses);
                multiply(&mut masses, backward);
                masses
            })
            .collect()
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
