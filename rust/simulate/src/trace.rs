//! The readable record of a run.

use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hasher as _};
use std::time::Duration;

/// Lines in order of time: the hash of all, and the last ones (all of them if the run is recorded).
pub(crate) struct Trace {
    hash: DefaultHasher,
    lines: VecDeque<String>,
    keep: usize,
}

/// Lines that a run keeps which is not recorded.
const KEPT: usize = 40;

impl Trace {
    pub(crate) fn new(recorded: bool) -> Self {
        Self {
            hash: DefaultHasher::new(), // its keys are constant
            lines: VecDeque::new(),
            keep: if recorded { usize::MAX } else { KEPT },
        }
    }

    pub(crate) fn line(&mut self, now: Duration, text: &str) {
        let line = format!("{:12.6} {text}", now.as_secs_f64());
        self.hash.write(line.as_bytes());
        self.hash.write_u8(b'\n');
        if self.lines.len() >= self.keep {
            self.lines.pop_front();
        }
        self.lines.push_back(line);
    }

    pub(crate) fn finish(self) -> (u64, Vec<String>) {
        (self.hash.finish(), self.lines.into())
    }
}
