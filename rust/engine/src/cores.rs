//! Cores that steps share: each has one, and borrows those that are idle.

use egp_core::Executor;

use crate::sync::atomic::{AtomicUsize, Ordering};
use crate::sync::{Arc, ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// The number of cores that this process may use, at least 1.
pub fn available_cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// A number of cores, and how many of them are in use.
#[derive(Debug)]
pub(crate) struct Cores {
    helpers: ThreadPool,
    total: usize,
    taken: AtomicUsize,
}

/// Cores in use, which are returned when this value is dropped.
#[derive(Debug)]
pub(crate) struct Taken<'a> {
    cores: &'a Cores,
    count: usize,
}

impl Cores {
    /// `total` cores, at least two, with `total - 1` threads that wait for parts of steps.
    pub fn new(total: usize) -> Result<Arc<Self>, ThreadPoolBuildError> {
        let helpers = ThreadPoolBuilder::new()
            .num_threads(total.max(2) - 1)
            .thread_name(|index| format!("egp-part-{index}"))
            .build()?;
        Ok(Arc::new(Self {
            helpers,
            total: total.max(2),
            taken: AtomicUsize::new(0),
        }))
    }

    /// The core that a step runs on.
    pub(crate) fn occupy(&self) -> Taken<'_> {
        self.taken.fetch_add(1, Ordering::Relaxed);
        Taken {
            cores: self,
            count: 1,
        }
    }

    /// Borrows up to `wanted` cores that no step uses.
    fn borrow(&self, wanted: usize) -> Taken<'_> {
        let mut count = 0;
        let _ = self
            .taken
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |taken| {
                count = wanted.min(self.total.saturating_sub(taken));
                Some(taken + count)
            });
        Taken { cores: self, count }
    }
}

impl Drop for Taken<'_> {
    fn drop(&mut self) {
        self.cores.taken.fetch_sub(self.count, Ordering::Relaxed);
    }
}

impl Executor for Cores {
    fn parallelism(&self) -> usize {
        1 + self
            .total
            .saturating_sub(self.taken.load(Ordering::Relaxed))
    }

    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        let idle = self.borrow(parts.saturating_sub(1));
        let next = AtomicUsize::new(0);
        let work = || {
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                if index >= parts {
                    break;
                }
                part(index);
            }
        };
        if idle.count == 0 {
            return work();
        }
        self.helpers.in_place_scope(|scope| {
            for _ in 0..idle.count {
                scope.spawn(|_| work());
            }
            work();
        });
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::Barrier;
    use std::thread;

    use super::*;

    #[test]
    fn idle_cores_work_at_once_and_are_given_back() {
        let cores = Cores::new(2).unwrap();
        let _own = cores.occupy();
        assert_eq!(cores.parallelism(), 2);
        // Each part waits for the other, so one thread could not do both.
        let both = Barrier::new(2);
        cores.run(2, &|_| {
            both.wait();
        });
        assert_eq!(cores.parallelism(), 2);
    }

    #[test]
    fn taken_cores_are_not_borrowed() {
        let cores = Cores::new(2).unwrap();
        let _steps = (cores.occupy(), cores.occupy());
        let caller = thread::current().id();
        assert_eq!(cores.parallelism(), 1);
        cores.run(3, &|_| assert_eq!(thread::current().id(), caller));
    }

    #[test]
    fn a_part_that_panics_takes_no_core_with_it() {
        let cores = Cores::new(2).unwrap();
        let ended = catch_unwind(AssertUnwindSafe(|| {
            let _own = cores.occupy();
            cores.run(2, &|index| assert_eq!(index, 0, "on purpose"));
        }));
        assert!(ended.is_err());
        assert_eq!(cores.taken.load(Ordering::Relaxed), 0);
        let done = AtomicUsize::new(0);
        cores.run(4, &|_| {
            done.fetch_add(1, Ordering::Relaxed);
        });
        assert_eq!(done.into_inner(), 4);
    }
}
