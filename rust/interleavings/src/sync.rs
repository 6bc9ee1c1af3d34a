//! Shuttle's locks, channels and threads under the names that the service and the engine use.

use std::sync::atomic::{AtomicUsize, Ordering};

pub(crate) use shuttle::sync::{
    Arc, Condvar, Mutex, MutexGuard, PoisonError, RwLock, atomic, mpsc,
};
pub(crate) use shuttle::thread;

/// The error of rayon's builder, which the builder of this file never returns.
pub(crate) type ThreadPoolBuildError = std::convert::Infallible;

/// What `cores.rs` uses of rayon's builder.
#[derive(Default)]
pub(crate) struct ThreadPoolBuilder {
    threads: usize,
}

#[allow(
    clippy::unused_self,
    clippy::unnecessary_wraps,
    reason = "the signatures are rayon's"
)]
impl ThreadPoolBuilder {
    pub(crate) fn new() -> Self {
        Self::default()
    }

    pub(crate) fn num_threads(self, threads: usize) -> Self {
        Self { threads }
    }

    pub(crate) fn thread_name(self, _name: impl Fn(usize) -> String) -> Self {
        self
    }

    pub(crate) fn build(self) -> Result<ThreadPool, ThreadPoolBuildError> {
        Ok(ThreadPool {
            threads: self.threads,
            jobs: AtomicUsize::new(0),
            most: AtomicUsize::new(0),
        })
    }
}

/// What `cores.rs` uses of rayon's pool. Each job has a thread of its own, and the test fails if there were ever more jobs
/// than rayon's pool has threads.
#[derive(Debug)]
pub(crate) struct ThreadPool {
    threads: usize,
    jobs: AtomicUsize,
    most: AtomicUsize,
}

/// The argument of a job, which `cores.rs` does not use.
pub(crate) struct Worker;

/// Jobs that end before the call of [`ThreadPool::in_place_scope`] returns.
pub(crate) struct Scope<'scope, 'env> {
    threads: &'scope thread::Scope<'scope, 'env>,
    pool: &'env ThreadPool,
}

impl ThreadPool {
    pub(crate) fn in_place_scope<'env, R>(
        &'env self,
        operation: impl for<'scope> FnOnce(&Scope<'scope, 'env>) -> R,
    ) -> R {
        let result = thread::scope(|threads| {
            operation(&Scope {
                threads,
                pool: self,
            })
        });
        // A panic while jobs run would leave them with references that are no longer valid.
        let most = self.most.load(Ordering::Relaxed);
        assert!(most <= self.threads, "{most} cores are lent");
        result
    }
}

impl<'scope> Scope<'scope, '_> {
    pub(crate) fn spawn(&self, job: impl FnOnce(&Worker) + Send + 'scope) {
        let pool = self.pool;
        let jobs = 1 + pool.jobs.fetch_add(1, Ordering::Relaxed);
        pool.most.fetch_max(jobs, Ordering::Relaxed);
        self.threads.spawn(move || {
            job(&Worker);
            pool.jobs.fetch_sub(1, Ordering::Relaxed);
        });
    }
}
