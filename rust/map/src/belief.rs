//! Belief about the friction along a road.

use egp_parameters::FRICTION_HYPOTHESES;

use crate::grid::{Grid, Row, interpolate, normalise, to_probabilities};

/// Length of a cell in m, at most.
const CELL: f64 = 2.0;
/// Stretch in m behind the first and ahead of the last place whose evidence counts.
const REACH: f64 = 60.0;

/// How a road's friction changes, and how careful the plans are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeliefSettings {
    /// Mean distance in m between changes of the surface.
    pub change_distance: f64,
    /// Distance in m over which the vehicle cannot react to a change: plans reckon with a change within it at every
    /// place.
    pub commitment: f64,
    /// Largest logarithm of a likelihood ratio that a cell keeps, in nats.
    pub capacity: f64,
}

impl Default for BeliefSettings {
    fn default() -> Self {
        Self {
            change_distance: 200.0,
            commitment: 40.0,
            capacity: 6.0,
        }
    }
}

/// A number that a belief cannot use.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("expected {expected} for {name}, got {value}")]
pub struct BeliefError {
    /// Name of the argument.
    pub name: &'static str,
    /// Accepted values.
    pub expected: &'static str,
    /// The value given.
    pub value: f64,
}

/// Belief about the friction of a road, from evidence in cells of at most 2 m.
///
/// The friction is a Markov chain along the cells: from one cell to the next it stays, or with probability
/// `1 - exp(-cell / change_distance)` is drawn anew from the uniform prior. Each cell has the likelihood of what was
/// measured in it, and the belief at a place is the posterior given the evidence behind and ahead of it, by the
/// forward-backward recursion (Rabiner, *A Tutorial on Hidden Markov Models*, Proceedings of the IEEE 77(2), 1989).
#[derive(Debug, Clone)]
pub struct RoadBelief {
    settings: BeliefSettings,
    grid: Grid,
    closed: bool,
    cell: f64,
    /// Logarithm of the likelihood in each cell, at most 0.
    evidence: Vec<Row>,
    /// Its exponential.
    likelihood: Vec<Row>,
    /// Memory of the forward recursion.
    forward: Vec<Row>,
    masses: Vec<Row>,
}

impl RoadBelief {
    /// A belief without evidence about a road of `length` m, which is a lap if `closed`.
    ///
    /// # Errors
    /// [`BeliefError`] unless the length and the settings are positive and finite.
    pub fn new(length: f64, closed: bool, settings: &BeliefSettings) -> Result<Self, BeliefError> {
        for (name, value) in [
            ("length", length),
            ("change_distance", settings.change_distance),
            ("commitment", settings.commitment),
            ("capacity", settings.capacity),
        ] {
            positive(name, value)?;
        }
        let cells = (length / CELL).ceil();
        Ok(Self {
            settings: *settings,
            grid: Grid::new(),
            closed,
            cell: length / cells,
            evidence: vec![[0.0; _]; cells as usize],
            likelihood: vec![[1.0; _]; cells as usize],
            forward: Vec::new(),
            masses: Vec::new(),
        })
    }

    /// Adds `weight` times a logarithm of a likelihood to the cells from `from` to `to` (m along the road), each by
    /// its share of the stretch.
    ///
    /// # Errors
    /// [`BeliefError`] unless all numbers are finite, `from <= to`, and the likelihoods' logarithms are at most 0.
    pub fn observe(
        &mut self,
        from: f64,
        to: f64,
        log_likelihood: &[f64; FRICTION_HYPOTHESES],
        weight: f64,
    ) -> Result<(), BeliefError> {
        finite("from", from)?;
        finite("to", to)?;
        positive("weight", weight)?;
        for value in log_likelihood {
            if !(f64::MIN..=0.0).contains(value) {
                return Err(BeliefError {
                    name: "log_likelihood",
                    expected: "finite numbers of at most 0",
                    value: *value,
                });
            }
        }
        let log_likelihood = interpolate(log_likelihood);
        let (first, last) = (self.index(from), self.index(to));
        for index in first..=last.min(first + self.evidence.len() as i64 - 1) {
            let (start, end) = (index as f64 * self.cell, (index + 1) as f64 * self.cell);
            let share = if to > from {
                (to.min(end) - from.max(start)) / (to - from)
            } else {
                1.0
            };
            let Some(cell) = self.stored(index) else {
                continue;
            };
            let evidence = &mut self.evidence[cell];
            for (sum, value) in evidence.iter_mut().zip(&log_likelihood) {
                *sum += weight * share * value;
            }
            let most = evidence.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let least = -self.settings.capacity;
            evidence
                .iter_mut()
                .for_each(|value| *value = (*value - most).max(least));
            self.likelihood[cell] = evidence.map(f64::exp);
        }
        Ok(())
    }

    /// Writes the friction to plan for at places `step` m apart from `start` on: the coefficient below which the
    /// friction lies with the probability `risk`.
    ///
    /// # Errors
    /// [`BeliefError`] unless `start` is finite, `step` positive, and `risk` in (0, 1).
    pub fn ahead(
        &mut self,
        start: f64,
        step: f64,
        risk: f64,
        friction: &mut [f64],
    ) -> Result<(), BeliefError> {
        finite("start", start)?;
        positive("step", step)?;
        if !(risk > 0.0 && risk < 1.0) {
            return Err(BeliefError {
                name: "risk",
                expected: "a probability in (0, 1)",
                value: risk,
            });
        }
        let first = self.index(start);
        let last = self.index(start + step * friction.len().saturating_sub(1) as f64);
        self.smooth(first, last);
        let committed = 1.0 - (-self.settings.commitment / self.settings.change_distance).exp();
        let prior = self.grid.prior;
        for (i, out) in friction.iter_mut().enumerate() {
            let index = self.index(start + step * i as f64);
            let place = (index - first) as usize;
            let likelihood = self.likelihood_of(index);
            let masses: Row = std::array::from_fn(|h| {
                let predicted = self.forward[place][h];
                let predicted = predicted + committed * (prior[h] - predicted);
                predicted * likelihood[h] * self.masses[place][h]
            });
            *out = self.grid.quantile(&masses, risk);
        }
        Ok(())
    }

    /// Quantiles of the friction at a place.
    ///
    /// # Errors
    /// [`BeliefError`] unless `s` is finite.
    pub fn quantiles<const N: usize>(
        &mut self,
        s: f64,
        shares: [f64; N],
    ) -> Result<[f64; N], BeliefError> {
        finite("s", s)?;
        let index = self.index(s);
        self.smooth(index, index);
        let likelihood = self.likelihood_of(index);
        let masses: Row =
            std::array::from_fn(|h| self.forward[0][h] * likelihood[h] * self.masses[0][h]);
        Ok(shares.map(|share| self.grid.quantile(&masses, share)))
    }

    /// Computes the forward messages (probabilities before the cell's own evidence) and the backward messages of the
    /// cells `first..=last`.
    fn smooth(&mut self, first: i64, last: i64) {
        let reach = (REACH / self.cell).ceil() as i64;
        let change = 1.0 - (-self.cell / self.settings.change_distance).exp();
        let prior = self.grid.prior;
        self.forward.clear();
        self.masses.clear();
        self.masses.resize((last - first + 1) as usize, [0.0; _]);
        let mut message = prior;
        for index in first - reach..=last {
            if index >= first {
                self.forward.push(message);
            }
            let likelihood = self.likelihood_of(index);
            (0..message.len()).for_each(|h| message[h] *= likelihood[h]);
            to_probabilities(&mut message);
            (0..message.len()).for_each(|h| message[h] += change * (prior[h] - message[h]));
        }
        let mut message: Row = [1.0; _];
        for index in (first..=last + reach).rev() {
            if index <= last {
                self.masses[(index - first) as usize] = message;
            }
            let likelihood = self.likelihood_of(index);
            (0..message.len()).for_each(|h| message[h] *= likelihood[h]);
            let mean: f64 = message.iter().zip(&prior).map(|(m, p)| m * p).sum();
            (0..message.len()).for_each(|h| message[h] += change * (mean - message[h]));
            normalise(&mut message);
        }
    }

    fn index(&self, s: f64) -> i64 {
        (s / self.cell).floor() as i64
    }

    /// Index of a stored cell; `None` beyond the ends of an open road.
    fn stored(&self, index: i64) -> Option<usize> {
        let count = self.evidence.len() as i64;
        if self.closed {
            return Some(index.rem_euclid(count) as usize);
        }
        (0..count).contains(&index).then_some(index as usize)
    }

    fn likelihood_of(&self, index: i64) -> Row {
        self.stored(index)
            .map_or([1.0; _], |cell| self.likelihood[cell])
    }
}

fn finite(name: &'static str, value: f64) -> Result<(), BeliefError> {
    if value.is_finite() {
        return Ok(());
    }
    Err(BeliefError {
        name,
        expected: "a finite number",
        value,
    })
}

fn positive(name: &'static str, value: f64) -> Result<(), BeliefError> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(BeliefError {
        name,
        expected: "a positive number",
        value,
    })
}
