//! Parallel evaluation of members: it gives the same bits and is used only for enough work.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use egp_core::{Executor, Kernel, Library, StepReply, Workspace, step};
use egp_testing::libraries;
use egp_testing::requests::{Request, settings};

/// Runs each part in its own thread, the last part first.
#[derive(Default)]
struct Threads {
    parts: AtomicUsize,
}

impl Executor for Threads {
    fn parallelism(&self) -> usize {
        8
    }

    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        self.parts.fetch_add(parts, Ordering::Relaxed);
        thread::scope(|scope| {
            for index in (0..parts).rev() {
                scope.spawn(move || part(index));
            }
        });
    }
}

/// The reply to a first request, and the number of parts given to the executor.
fn solve(
    library: &Library,
    want_sigma: bool,
    executor: Option<Arc<Threads>>,
) -> (StepReply, usize) {
    let mut request = Request::circle();
    // Without a window all weights are equal.
    let repeats = if want_sigma { 0 } else { 6 };
    request.history_z = request.history_z.repeat(repeats);
    request.history_y = request.history_y.repeat(repeats);
    let mut settings = settings();
    settings.weights.window = Some(60);
    let mut workspace = Workspace::new(library, &settings).unwrap();
    if let Some(executor) = &executor {
        workspace = workspace.with_executor(executor.clone());
    }
    let (mut reply, mut wanted) = (StepReply::default(), request.borrow());
    wanted.want_sigma = want_sigma;
    step(library, &settings, &wanted, &mut workspace, &mut reply).unwrap();
    let parts = executor.map_or(0, |executor| executor.parts.load(Ordering::Relaxed));
    (reply, parts)
}

fn check(members: u32, n: usize, want_sigma: bool, expected: usize) {
    let frictions: Vec<f64> = (0..members).map(|i| 0.4 + 0.02 * f64::from(i)).collect();
    let library = libraries::library(Kernel::Rbf, &frictions, n, 3);
    let (sequential, _) = solve(&library, want_sigma, None);
    let (parallel, parts) = solve(&library, want_sigma, Some(Arc::default()));
    assert_eq!(sequential, parallel);
    assert_eq!(parts, expected);
}

#[test]
fn standard_deviations_of_many_members_run_in_parallel() {
    check(8, 450, true, 8);
}

#[test]
fn standard_deviations_of_two_members_run_sequentially() {
    check(2, 450, true, 0);
}

#[test]
fn missing_predictions_of_many_members_run_in_parallel() {
    check(16, 450, false, 60);
}
