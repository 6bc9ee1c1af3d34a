//! One warm control step for instruction counters: 2 members of 700 points, horizon 20, window 10.
//!
//! `tests/bench/instructions.py` runs it under callgrind, which collects only inside [`counted_step`]: making the
//! library and warming up do not count.
#![allow(clippy::unwrap_used)]

#[path = "../tests/support/mod.rs"]
mod support;

use egp_core::{Kernel, Library, Settings, Status, StepReply, StepRequest, Workspace, step};

/// The function that is counted, under a name that a profiler finds.
#[inline(never)]
fn counted_step(
    library: &Library,
    settings: &Settings,
    request: &StepRequest,
    ws: &mut Workspace,
    reply: &mut StepReply,
) {
    step(library, settings, request, ws, reply).unwrap();
}

fn main() {
    let (library, settings) = (
        support::library(Kernel::Rbf, &[0.5, 1.1], 700, 3),
        Settings::default(),
    );
    let mut ws = Workspace::new(&library, &settings).unwrap();
    let mut reply = StepReply::default();
    let mut request = support::request::Request::circle();
    step(&library, &settings, &request.borrow(), &mut ws, &mut reply).unwrap();
    request.carry(&reply);
    request.history_f.drain(..6); // the newest transition is new
    counted_step(&library, &settings, &request.borrow(), &mut ws, &mut reply);
    assert_eq!(reply.status, Status::Solved);
    println!("{} iterations", reply.iterations);
}
