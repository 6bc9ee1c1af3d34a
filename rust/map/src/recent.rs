//! What the newest window found, before it is stored.

use crate::grid::Row;

/// The likelihood of one window, spread over the cells from `first` on: each of them has an equal share of its logarithm.
///
/// Evidence is stored where the middle third of a window was, and with the weight of one transition. This one is replaced
/// in each period, so that the belief at the vehicle contains all transitions up to now.
#[derive(Debug, Clone)]
pub(crate) struct Recent {
    first: i64,
    cells: i64,
    likelihood: Row,
}

impl Recent {
    /// For the cells `first..=last`, from the logarithm of the window's likelihood.
    pub fn new(first: i64, last: i64, log_likelihood: &Row) -> Self {
        let cells = last - first + 1;
        Self {
            first,
            cells,
            likelihood: log_likelihood.map(|value| (value / cells as f64).exp()),
        }
    }

    /// The share of a stored cell, of `count` in all; `None` outside the window.
    pub fn at(&self, cell: usize, count: usize) -> Option<&Row> {
        let after = (cell as i64 - self.first).rem_euclid(count as i64);
        (after < self.cells).then_some(&self.likelihood)
    }
}
