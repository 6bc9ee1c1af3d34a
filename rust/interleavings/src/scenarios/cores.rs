//! Steps at the same time that share cores.

use std::sync::atomic::{AtomicUsize, Ordering};

use egp_core::{Executor as _, Sequential};

use crate::cores::Cores;
use crate::sync::thread;

/// What one part of a step writes.
fn part(index: usize) -> usize {
    (index + 1) * (index + 1)
}

/// Runs the parts of one step and returns what they wrote; each part adds its result to its own place.
fn results(executor: &dyn egp_core::Executor, parts: usize) -> Vec<usize> {
    let places: Vec<_> = (0..parts).map(|_| AtomicUsize::new(0)).collect();
    executor.run(parts, &|index| {
        places[index].fetch_add(part(index), Ordering::Relaxed);
    });
    places.into_iter().map(AtomicUsize::into_inner).collect()
}

/// Three steps at the same time on three cores: no more cores are lent than there are threads for, which the thread pool of
/// `sync.rs` checks; each part runs once, and no core is in use afterwards.
pub fn steps_share_cores() {
    const TOTAL: usize = 3;
    let cores = Cores::new(TOTAL).unwrap();
    let steps: Vec<_> = [2, 3, 4]
        .into_iter()
        .map(|parts| {
            let cores = cores.clone();
            thread::spawn(move || {
                let _own = cores.occupy();
                assert!((1..=TOTAL).contains(&cores.parallelism()));
                assert_eq!(results(&*cores, parts), results(&Sequential, parts));
            })
        })
        .collect();
    for step in steps {
        step.join().unwrap();
    }
    assert_eq!(cores.parallelism(), 1 + TOTAL);
}
