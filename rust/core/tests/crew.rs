//! Members evaluated at once: the same bits, and only where it pays.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use egp_core::{Crew, Kernel, Library, StepReply, Workspace, step};
use egp_testing::libraries;
use egp_testing::requests::{Request, settings};

/// A thread for each part, the last part first.
#[derive(Default)]
struct Threads {
    parts: AtomicUsize,
}

impl Crew for Threads {
    fn hands(&self) -> usize {
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

/// The reply to a first request, and the parts that were given away.
fn solve(library: &Library, want_sigma: bool, crew: Option<Arc<Threads>>) -> (StepReply, usize) {
    let mut request = Request::circle();
    // Without a window all members count alike.
    let repeats = if want_sigma { 0 } else { 6 };
    request.history_z = request.history_z.repeat(repeats);
    request.history_y = request.history_y.repeat(repeats);
    let mut settings = settings();
    settings.weights.window = Some(60);
    let mut workspace = Workspace::new(library, &settings).unwrap();
    if let Some(crew) = &crew {
        workspace = workspace.with_crew(crew.clone());
    }
    let (mut reply, mut wanted) = (StepReply::default(), request.borrow());
    wanted.want_sigma = want_sigma;
    step(library, &settings, &wanted, &mut workspace, &mut reply).unwrap();
    let parts = crew.map_or(0, |crew| crew.parts.load(Ordering::Relaxed));
    (reply, parts)
}

fn check(members: u32, n: usize, want_sigma: bool, expected: usize) {
    let frictions: Vec<f64> = (0..members).map(|i| 0.4 + 0.02 * f64::from(i)).collect();
    let library = libraries::library(Kernel::Rbf, &frictions, n, 3);
    let (alone, _) = solve(&library, want_sigma, None);
    let (shared, parts) = solve(&library, want_sigma, Some(Arc::default()));
    assert_eq!(alone, shared);
    assert_eq!(parts, expected);
}

#[test]
fn standard_deviations_of_many_members_are_shared_out() {
    check(8, 450, true, 8);
}

#[test]
fn those_of_two_are_not() {
    check(2, 450, true, 0);
}

#[test]
fn a_window_without_predictions_is_shared_out_for_many_members() {
    check(16, 450, false, 60);
}
