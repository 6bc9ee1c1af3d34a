//! The evidence of the newest window before it is stored.

use crate::grid::Row;

/// The likelihood of one window, spread over the cells from `first` on: each of them has an equal share of its logarithm.
///
/// Evidence is stored where the middle third of a window was, and with the weight of one transition. The likelihood here is
/// replaced in each period, so that the belief at the vehicle contains all transitions up to now.
#[derive(Debug, Clone)]
pub(crate) struct Recent {
    /// A stored cell of a lap; on an open road the cell may lie before the start or beyond the end.
    first: i64,
    cells: i64,
    /// Number of cells of a lap; zero on an open road.
    lap: i64,
    likelihood: Row,
}

impl Recent {
    /// For the cells `first..=last`, from the logarithm of the window's likelihood. `lap` is the number of cells of a lap,
    /// and `None` on an open road.
    pub fn new(first: i64, last: i64, lap: Option<i64>, log_likelihood: &Row) -> Self {
        let cells = last - first + 1;
        Self {
            first: lap.map_or(first, |lap| first.rem_euclid(lap)),
            cells,
            lap: lap.unwrap_or_default(),
            likelihood: log_likelihood.map(|value| (value / cells as f64).exp()),
        }
    }

    /// The share of a stored cell; `None` outside the window.
    pub fn at(&self, cell: usize) -> Option<&Row> {
        let mut after = cell as i64 - self.first;
        if after < 0 {
            after += self.lap;
        }
        (0..self.cells).contains(&after).then_some(&self.likelihood)
    }
}
