//! Independent parts of a step, which may run in parallel.

use std::sync::Mutex;

/// Runs the parts of a step. The results have the same bits with every executor.
pub trait Executor: Send + Sync {
    /// Number of parts that can run in parallel now, the caller's thread included.
    fn parallelism(&self) -> usize;

    /// Calls `part` once with each number below `parts`, in any order and possibly in parallel. Returns after the last
    /// call has returned.
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync));
}

/// Runs all parts on the caller's thread, one after the other.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sequential;

impl Executor for Sequential {
    fn parallelism(&self) -> usize {
        1
    }

    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        (0..parts).for_each(part);
    }
}

/// Smallest total work, in ns, that is run in parallel: a sleeping thread of a virtual machine wakes up to 0.1 ms late.
const MIN_PARALLEL_WORK: usize = 400_000;

/// Calls `part` with each of the parts, in parallel if their total work of about `nanoseconds` is large enough.
/// Sequential calls allocate nothing.
pub(crate) fn for_each<T: Send>(
    executor: &dyn Executor,
    nanoseconds: usize,
    parts: impl Iterator<Item = T>,
    part: impl Fn(T) + Sync,
) {
    if nanoseconds < MIN_PARALLEL_WORK || executor.parallelism() < 2 {
        return parts.for_each(part);
    }
    let parts: Vec<_> = parts.map(|part| Mutex::new(Some(part))).collect();
    executor.run(parts.len(), &|index| {
        if let Ok(Some(taken)) = parts[index].lock().map(|mut slot| slot.take()) {
            part(taken);
        }
    });
}
