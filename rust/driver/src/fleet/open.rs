//! Queries that wait for their answers.

use crate::driver::Time;

/// A query whose end has not been reported.
#[derive(Clone, Debug)]
pub(super) struct Open {
    pub(super) subject: Subject,
    /// Whether a map service replied, if only with an error.
    pub(super) exists: bool,
    /// Whether it had a reply, or an error at which another attempt would not succeed.
    pub(super) decided: bool,
    /// Whether the tiles behind those of its answer were asked for. An answer may come twice.
    pub(super) asked_on: bool,
}

impl Open {
    pub(super) fn new(subject: Subject) -> Self {
        Self {
            subject,
            exists: false,
            decided: false,
            asked_on: false,
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Subject {
    /// Evidence about a tile, noticed at a time.
    Evidence(u32, Time),
    /// A question for tiles.
    Tiles { first: u32, last: u32 },
}
