//! The members' predictions of transitions.

use crate::GpOutput;

/// Predictions of `members` members for some transitions, `[rows, members]` in one piece, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Predictions {
    /// Number of members, N; 0 when there is no row.
    pub members: usize,
    /// The rows, one after another.
    pub values: Vec<GpOutput>,
}

impl Predictions {
    /// Predictions from rows with `members` of them each.
    pub fn new(members: usize, values: Vec<GpOutput>) -> Self {
        let members = if values.is_empty() { 0 } else { members };
        Self { members, values }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows().len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The rows, one per transition.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[GpOutput]> {
        self.values.chunks(self.members.max(1))
    }
}
