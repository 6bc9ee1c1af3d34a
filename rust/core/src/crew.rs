//! Independent parts of a step, which may run at once.

use std::sync::Mutex;

/// Whoever runs the parts; the bits that come out are the same, whoever it is.
pub trait Crew: Send + Sync {
    /// How many parts could run at once now, the caller's included.
    fn hands(&self) -> usize;

    /// Calls `part` once with each number below `parts`, in any order and perhaps at once; returns when all are done.
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync));
}

/// The caller, one part after the other.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Crew for Alone {
    fn hands(&self) -> usize {
        1
    }

    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        (0..parts).for_each(part);
    }
}

/// Less work than this, in ns, is not shared: threads that sleep take up to 0.1 ms to wake, in virtual machines.
const WORTH: usize = 400_000;

/// Calls `part` with each of the parts, which together take about `nanoseconds`; at once where that pays. Where it
/// does not, nothing is allocated.
pub(crate) fn each<T: Send>(
    crew: &dyn Crew,
    nanoseconds: usize,
    parts: impl Iterator<Item = T>,
    part: impl Fn(T) + Sync,
) {
    if nanoseconds < WORTH || crew.hands() < 2 {
        return parts.for_each(part);
    }
    let parts: Vec<_> = parts.map(|part| Mutex::new(Some(part))).collect();
    crew.run(parts.len(), &|index| {
        if let Ok(Some(taken)) = parts[index].lock().map(|mut slot| slot.take()) {
            part(taken);
        }
    });
}
