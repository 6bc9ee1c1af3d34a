//! Belief about the friction along a road.

use std::collections::{BTreeSet, VecDeque};
use std::mem::take;

use egp_parameters::FRICTION_HYPOTHESES;

use crate::belief_error::{BeliefError, check, log_likelihood_of_step, place};
use crate::grid::{Grid, Row, interpolate_with_dead_zone, pass_backward, pass_forward};
use crate::layer::Layer;
use crate::recent::Recent;
use crate::reported::Reported;
use crate::tile::TILE_CELLS;

// The lengths are those of roads of full-size vehicles, and are multiplied by the scale of a belief.

/// Length of a cell in m, at most.
const CELL: f64 = 2.0;
/// Stretch in m behind the first and ahead of the last planned place whose evidence counts. It limits the computing time.
pub(crate) const REACH: f64 = 60.0;

/// Distance in m by which a border of surfaces may be found too late or too early, since a window covers several
/// metres: plans take the lowest friction within it.
pub(crate) const BLUR: f64 = 4.0;

/// Longest road of full-size vehicles, m.
const LONGEST: f64 = 1e6;
/// Least length of a road, m.
const SHORTEST: f64 = 1.0;
/// Distance, m, that no vehicle drives in a control period.
const JUMP: f64 = 100.0;
/// Window of a new belief, in transitions.
const DEFAULT_WINDOW: usize = 25;
/// Longest window, in transitions.
const WINDOW: f64 = 1000.0;
/// Smallest scale: cells of 2 cm.
const SMALLEST: f64 = 0.01;

/// Mean distance in m between changes of the surface.
pub(crate) const CHANGE_DISTANCE: f64 = 200.0;
/// Distance in m within which the vehicle cannot react to what lies ahead. With the probability that the surface changes
/// within this distance, plans assume that a place is on a patch, about which only evidence measured within 8 m counts.
pub(crate) const COMMITMENT: f64 = 45.0;
/// Largest logarithm of a likelihood ratio that a cell keeps, in nats.
const CAPACITY: f64 = 6.0;
/// Logarithm of the likelihood ratio in nats up to which a window does not tell coefficients apart.
const INDIFFERENCE: f64 = 0.25;

/// Belief about the friction of a road, from evidence in cells of at most 2 m, or shorter ones ([`Self::with_scale`]).
///
/// The friction is a Markov chain along the cells: from one cell to the next it stays, or with probability
/// `1 - exp(-cell / 200 m)` is drawn anew from the uniform prior. Each cell has the likelihood of what was
/// measured in it, and the belief at a place is the posterior given the evidence behind and ahead of it, by the
/// forward-backward recursion (Rabiner, *A Tutorial on Hidden Markov Models*, Proceedings of the IEEE 77(2), 1989).
#[derive(Debug, Clone)]
pub struct RoadBelief {
    /// Number of transitions `K` from which a control step estimates the friction.
    pub(crate) window: usize,
    pub(crate) grid: Grid,
    closed: bool,
    /// Points of the road with equal distances in m, by which it is told from others; may be empty.
    pub(crate) shape: Vec<[f64; 2]>,
    /// Factor of all lengths of the belief, 1 on roads of full-size vehicles.
    scale: f64,
    pub(crate) cell: f64,
    /// Where the vehicle was at the starts of the last periods, newest last.
    pub(crate) track: VecDeque<f64>,
    /// Logarithm of the likelihood in each cell, at most 0.
    evidence: Vec<Row>,
    /// Evidence measured since the belief was made. `None` while nothing was recalled; `evidence` is then the same.
    measured: Option<Vec<Row>>,
    /// Exponential of `evidence`.
    pub(crate) likelihood: Vec<Row>,
    /// The evidence of the newest window, most of which is not stored yet.
    pub(crate) recent: Option<Recent>,
    /// What other vehicles reported.
    pub(crate) reported: Option<Reported>,
    /// Tiles whose evidence changed since the last call of [`Self::take_changed`].
    pub(crate) changed: BTreeSet<usize>,
    /// Messages of the forward recursion: probabilities before the cell's own evidence.
    pub(crate) forward: Vec<Row>,
    /// Messages of the backward recursion.
    pub(crate) backward: Vec<Row>,
}

impl RoadBelief {
    /// A belief without evidence about a road of `length` m, which is a lap if `closed`, with a window of 25 transitions.
    ///
    /// # Errors
    /// [`BeliefError`] unless the length is from 1 m to 1000 km.
    pub fn new(length: f64, closed: bool) -> Result<Self, BeliefError> {
        check("length", length, "a length from 1 to 1e6 m", |v| {
            (SHORTEST..=LONGEST).contains(&v)
        })?;
        Ok(Self::empty(length, closed, 1.0))
    }

    /// A belief without evidence about the same road, for vehicles of this
    /// [scale](egp_parameters::VehicleParameters::scale), by which all lengths are multiplied: cells, patches, the distance
    /// between changes of the surface, and that within which a vehicle cannot react.
    ///
    /// The scale is rounded to a multiple of 0.0005, with which the longest cells are whole millimetres. Only beliefs of the
    /// same rounded scale exchange tiles and files.
    ///
    /// # Errors
    /// [`BeliefError`] unless the scale is 0.01 to 1 and the road is at most 1000 km times the scale long.
    pub fn with_scale(self, scale: f64) -> Result<Self, BeliefError> {
        check("scale", scale, "0.01 to 1", |v| {
            (SMALLEST..=1.0).contains(&v)
        })?;
        let scale = (scale * CELL * 1e3).round() / (CELL * 1e3);
        // The length is that of all cells, and may be rounded up.
        let (length, most) = (self.length(), scale * LONGEST * (1.0 + 1e-9));
        check("length", length, "at most 1e6 m times the scale", |v| {
            v <= most
        })?;
        Ok(Self {
            window: self.window,
            shape: self.shape,
            ..Self::empty(length, self.closed, scale)
        })
    }

    /// A belief without evidence.
    fn empty(length: f64, closed: bool, scale: f64) -> Self {
        let cells = (length / (scale * CELL)).ceil();
        Self {
            window: DEFAULT_WINDOW,
            grid: Grid::new(),
            closed,
            shape: Vec::new(),
            scale,
            cell: length / cells,
            track: VecDeque::with_capacity(DEFAULT_WINDOW + 1),
            evidence: vec![[0.0; _]; cells as usize],
            measured: None,
            likelihood: vec![[1.0; _]; cells as usize],
            recent: None,
            reported: None,
            changed: BTreeSet::new(),
            forward: Vec::new(),
            backward: Vec::new(),
        }
    }

    /// The factor of all lengths of the belief.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// The largest length in m that its cells may have, 2 m times the scale. A road is divided into as few cells as this permits.
    pub fn longest_cell(&self) -> f64 {
        self.scale * CELL
    }

    /// A length in m of full-size vehicles as a number of cells.
    pub(crate) fn cells_of(&self, length: f64) -> f64 {
        self.scale * length / self.cell
    }

    /// Number of transitions from which a control step estimates the friction.
    pub fn window(&self) -> usize {
        self.window
    }

    /// Replaces the window. If its length changes, the places of the last periods and the newest window are discarded; the
    /// evidence of the cells remains.
    ///
    /// # Errors
    /// [`BeliefError`] unless it is 1 to 1000 transitions.
    pub fn set_window(&mut self, window: usize) -> Result<(), BeliefError> {
        check("window", window as f64, "1 to 1000 transitions", |v| {
            (1.0..=WINDOW).contains(&v)
        })?;
        if window != self.window {
            self.leave();
            self.window = window;
        }
        Ok(())
    }

    /// Length in m of the road.
    pub fn length(&self) -> f64 {
        self.cell * self.evidence.len() as f64
    }

    /// Whether the road is a lap.
    pub fn closed(&self) -> bool {
        self.closed
    }

    pub(crate) fn evidence(&self) -> &[Row] {
        &self.evidence
    }

    /// The evidence that was measured since the belief was made, without what was recalled.
    pub(crate) fn measured(&self) -> &[Row] {
        self.measured.as_ref().unwrap_or(&self.evidence)
    }

    /// Opens a control period of a vehicle at `s`, and adds what the last control step found.
    ///
    /// The estimate of a window belongs to the road that the vehicle passed in it. Its evidence goes to the middle third,
    /// so that a change of the surface is found where it is, and each period adds `1 / window` of it, because
    /// successive windows share all transitions but one. Until the next period it also counts once, as a whole, from the
    /// start of this third to the vehicle: otherwise a surface that has just begun would be believed only after most of the
    /// window lies on it.
    ///
    /// Logarithms of likelihoods that are smaller than the likeliest hypothesis's by at most `INDIFFERENCE` count as equal to
    /// it, and the others are raised by as much. Where no grip is used, the models of all coefficients predict nearly the
    /// same, and the small differences of their likelihoods are errors of the models. They do not become smaller with the number of
    /// windows, and would add up. Only ratios count: what is added to all logarithms changes nothing.
    ///
    /// # Errors
    /// [`BeliefError`] unless `s` is an arc length within ±1e9 m and the likelihoods' logarithms are from
    /// [`egp_parameters::LEAST_LOG_LIKELIHOOD`] to 0, as those of a control step are.
    pub fn update(
        &mut self,
        s: f64,
        log_likelihood: Option<&[f64; FRICTION_HYPOTHESES]>,
    ) -> Result<(), BeliefError> {
        place("s", s)?;
        for value in log_likelihood.into_iter().flatten() {
            log_likelihood_of_step("log_likelihood", *value)?;
        }
        if self.jumped(s) {
            self.leave();
        }
        let window = self.window;
        self.recent = None;
        if let Some(log_likelihood) = log_likelihood
            && self.track.len() > window
        {
            let most = (log_likelihood.iter().copied()).fold(f64::NEG_INFINITY, f64::max);
            let log_likelihood = &log_likelihood.map(|value| value - most);
            let (from, to) = (self.track[window / 3], self.track[2 * window / 3]);
            self.compare_with_reports(log_likelihood);
            let log_likelihood = interpolate_with_dead_zone(log_likelihood, INDIFFERENCE);
            self.add(from, to, &log_likelihood);
            let lap = self.closed.then_some(self.evidence.len() as i64);
            self.recent = self.between(from, s).map(|(from, to)| {
                Recent::new(self.index(from), self.index(to), lap, &log_likelihood)
            });
        }
        if self.track.len() > window {
            self.track.pop_front();
        }
        self.track.push_back(s);
        Ok(())
    }

    /// Whether the vehicle is farther from its last place than it can drive in a period.
    fn jumped(&self, s: f64) -> bool {
        let last = self.track.back();
        last.is_some_and(|last| (s - self.near(*last, s)).abs() > self.scale * JUMP)
    }

    /// Forgets where the vehicle was, for instance after it was moved; what was stored remains.
    pub fn leave(&mut self) {
        self.recent = None;
        self.track.clear();
        if let Some(reported) = &mut self.reported {
            reported.end_windows(self.window);
        }
    }

    /// The stretch from `from` to `to`, counted without a jump at the end of a lap. `None` if the vehicle drove backwards, was
    /// moved, or drove more than half of a lap.
    pub(crate) fn between(&self, from: f64, to: f64) -> Option<(f64, f64)> {
        let from = self.near(from, to);
        let cells = self.index(to) - self.index(from);
        (to >= from && cells < self.evidence.len() as i64).then_some((from, to))
    }

    /// Adds one period's evidence to the cells from `from` to `to`, each by its share of the stretch.
    fn add(&mut self, from: f64, to: f64, log_likelihood: &Row) {
        let Some((from, to)) = self.between(from, to) else {
            return;
        };
        let (first, last) = (self.index(from), self.index(to));
        for index in first..=last {
            let (start, end) = (index as f64 * self.cell, (index + 1) as f64 * self.cell);
            let share = if to > from {
                (to.min(end) - from.max(start)) / (to - from)
            } else {
                1.0
            };
            let Some(cell) = self.stored(index) else {
                continue;
            };
            self.add_to_cell(cell, share / self.window as f64, log_likelihood);
        }
    }

    /// Adds `weight` times a logarithm of a likelihood, which was measured now, to a cell.
    fn add_to_cell(&mut self, cell: usize, weight: f64, log_likelihood: &Row) {
        if log_likelihood.iter().all(|value| *value == 0.0) {
            return; // The evidence stays as it is, and as old as it is.
        }
        if let Some(measured) = &mut self.measured {
            accumulate(&mut measured[cell], weight, log_likelihood);
        }
        accumulate(&mut self.evidence[cell], weight, log_likelihood);
        self.likelihood[cell] = self.evidence[cell].map(f64::exp);
        self.changed.insert(cell / TILE_CELLS);
    }

    /// Adds `weight` times the logarithms of likelihoods of all cells that were measured before the belief was made.
    pub(crate) fn add_recalled(&mut self, weight: f64, rows: &[Row]) {
        if self.measured.is_none() {
            self.measured = Some(self.evidence.clone());
        }
        let cells = self.evidence.iter_mut().zip(&mut self.likelihood);
        for ((evidence, likelihood), row) in cells.zip(rows) {
            accumulate(evidence, weight, row);
            *likelihood = evidence.map(f64::exp);
        }
    }

    /// The number of cells within `reach` m, times the scale, on either side of a cell, and the largest number of cells whose
    /// messages may be computed at once from evidence up to there: on a lap no evidence may count twice.
    pub(crate) fn reach(&self, reach: f64) -> (i64, i64) {
        let reach = self.within(self.cells_of(reach).ceil());
        if !self.closed {
            return (reach, i64::MAX);
        }
        (reach, self.evidence.len() as i64 - 2 * reach)
    }

    /// A number of cells on either side of a cell, or fewer, so that no evidence counts twice on a lap.
    pub(crate) fn within(&self, cells: f64) -> i64 {
        let count = self.evidence.len() as i64;
        let cells = cells.min(count as f64) as i64;
        if self.closed {
            cells.min((count - 1) / 2)
        } else {
            cells
        }
    }

    /// Computes the messages of the cells `first..=last` from a layer's evidence up to `reach` cells beyond them.
    pub(crate) fn smooth(&mut self, layer: Layer, first: i64, last: i64, reach: i64) {
        let change = 1.0 - (-self.cell / (self.scale * CHANGE_DISTANCE)).exp();
        let (mut forward, mut backward) = (take(&mut self.forward), take(&mut self.backward));
        let cells = (last - first + 1) as usize;
        for messages in [&mut forward, &mut backward] {
            messages.resize(cells.max(messages.len()), [0.0; _]);
        }
        let prior = &self.grid.prior;
        let (mut from_behind, mut from_ahead): (Row, Row) = (*prior, [1.0; _]);
        // Neither recursion depends on the other one, so that a processor computes both at once.
        for (behind, ahead) in (first - reach..=last).zip((first..=last + reach).rev()) {
            if behind >= first {
                forward[(behind - first) as usize] = from_behind;
            }
            if ahead <= last {
                backward[(ahead - first) as usize] = from_ahead;
            }
            self.weigh(layer, behind, &mut from_behind);
            self.weigh(layer, ahead, &mut from_ahead);
            pass_forward(&mut from_behind, prior, change);
            pass_backward(&mut from_ahead, prior, change);
        }
        (self.forward, self.backward) = (forward, backward);
    }

    pub(crate) fn index(&self, s: f64) -> i64 {
        (s / self.cell).floor() as i64
    }

    /// Index of a stored cell; `None` beyond the ends of an open road.
    pub(crate) fn stored(&self, index: i64) -> Option<usize> {
        let count = self.evidence.len() as i64;
        if self.closed {
            return Some(index.rem_euclid(count) as usize);
        }
        (0..count).contains(&index).then_some(index as usize)
    }
}

/// Adds `weight` times a logarithm of a likelihood to a cell's evidence, whose largest number stays 0 and whose smallest one is
/// at least `-CAPACITY`.
fn accumulate(evidence: &mut Row, weight: f64, log_likelihood: &Row) {
    for (sum, value) in evidence.iter_mut().zip(log_likelihood) {
        *sum += weight * value;
    }
    let most = evidence.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    for value in evidence.iter_mut() {
        *value = (*value - most).max(-CAPACITY) + 0.0; // turns -0.0 into 0.0, so that equal evidence has equal bytes
    }
}
