//! A step allocates nothing after the first request of each shape: neither from a client's bytes to those of the reply,
//! nor in the mathematics alone.
#![allow(clippy::unwrap_used, missing_docs)]

use std::cell::Cell;

use crate::loopback::{engine, request};
use counting::allocations;
use egp_core::{StepReply, StepRequest, Workspace, step};
use egp_driver::Carry;
use egp_testing::requests;
use egp_wire::{Reply, Status};

/// The allocator of this program: the system's, with a count for each thread.
mod counting {
    // `GlobalAlloc` is an unsafe trait.
    #![allow(unsafe_code)]

    use std::alloc::{GlobalAlloc, Layout, System};

    use super::Cell;

    thread_local! {
        static COUNT: Cell<usize> = const { Cell::new(0) };
    }

    struct Counting;

    #[global_allocator]
    static ALLOCATOR: Counting = Counting;

    // SAFETY: each call is forwarded to `System` unchanged; the count is a constant-initialised cell, which allocates
    // nothing.
    unsafe impl GlobalAlloc for Counting {
        unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
            COUNT.set(COUNT.get() + 1);
            unsafe { System.alloc(layout) }
        }

        unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
            unsafe { System.dealloc(memory, layout) }
        }

        unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
            COUNT.set(COUNT.get() + 1);
            unsafe { System.realloc(memory, layout, size) }
        }
    }

    /// Allocations and reallocations by this thread while `work` ran.
    pub fn allocations(work: impl FnOnce()) -> usize {
        let before = COUNT.get();
        work();
        COUNT.get() - before
    }
}

/// A client's first requests: cold, then with a plan and a history that grows until the window is full.
fn drive(periods: usize, mut ask: impl FnMut(usize, &[u8], &mut Vec<u8>) -> Status) {
    let mut carry = Carry::new(engine().library().id(), 10);
    let mut reply = Vec::new();
    for period in 0..periods {
        let mut request = request(&mut carry);
        request.want_sigma = period % 3 == 2;
        assert_eq!(ask(period, &request.encode(), &mut reply), Status::Solved);
        // Every fourth reply is lost, so that predictions are missing and the plan is older.
        if period % 4 != 3 {
            let reply = Reply::decode(&reply).unwrap();
            carry.accept(&reply);
        }
    }
}

#[test]
fn from_bytes_to_bytes_a_warm_step_allocates_nothing() {
    let engine = engine();
    let mut workspace = engine.workspace().unwrap();
    drive(40, |period, request, reply| {
        let mut status = Status::Unspecified;
        let count = allocations(|| status = engine.step(&mut workspace, request, reply).unwrap());
        assert!(
            period < 15 || count == 0,
            "period {period}: {count} allocations"
        );
        status
    });
}

#[test]
fn the_mathematics_alone_allocates_nothing() {
    let (library, settings) = (requests::library(), requests::settings());
    let mut workspace = Workspace::new(library, &settings).unwrap();
    let mut reply = StepReply::default();
    let (cold, warm) = (requests::Request::circle(), requests::warm());
    for round in 0..3 {
        for (name, request, want_sigma) in [
            ("cold", &cold, false),
            ("warm", &warm, false),
            ("warm with sigma", &warm, true),
        ] {
            let request = StepRequest {
                want_sigma,
                ..request.borrow()
            };
            let count = allocations(|| {
                step(library, &settings, &request, &mut workspace, &mut reply).unwrap();
            });
            assert!(round == 0 || count == 0, "{name}: {count} allocations");
        }
    }
}

#[test]
fn the_count_is_not_blind() {
    assert_eq!(
        allocations(|| drop(std::hint::black_box(vec![1.0; 100]))),
        1
    );
}
