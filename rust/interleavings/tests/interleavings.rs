//! Runs the scenarios of the library under many interleavings of their threads.
#![allow(missing_docs)]

use std::path::{Path, PathBuf};

use egp_interleavings::scenarios::{cores, queue, reload, service};
use shuttle::scheduler::{PctScheduler, RandomScheduler};
use shuttle::{Config, Runner};

/// Bytes of each thread's stack; loading a library needs more than shuttle's 32 KiB.
const STACK: usize = 1 << 20;
const SEED: u64 = 14;

/// Runs a scenario under `count` interleavings each of two kinds: any thread may continue at each operation, and threads
/// have priorities, of which up to three change on the way. The message of a failure has the schedule, which
/// `shuttle::replay` repeats.
fn explore(count: usize, scenario: impl Fn() + Clone + Send + Sync + 'static) {
    let config = || {
        let mut config = Config::new();
        config.stack_size = STACK;
        config
    };
    Runner::new(RandomScheduler::new_from_seed(SEED, count), config()).run(scenario.clone());
    Runner::new(PctScheduler::new_from_seed(SEED, 3, count), config()).run(scenario);
}

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

#[test]
fn items_of_a_queue_end_once_and_in_order() {
    for capacity in [1, 2] {
        explore(4000, move || queue::items_end_once_and_in_order(capacity));
    }
}

#[test]
fn no_thread_sleeps_while_an_item_waits() {
    explore(4000, queue::no_thread_sleeps_while_an_item_waits);
}

#[test]
fn each_request_gets_its_answer() {
    explore(4000, service::each_request_gets_its_answer);
}

#[test]
fn a_service_that_drains_answers_everything() {
    explore(4000, service::a_service_that_drains_answers_everything);
}

#[test]
fn a_sealed_request_counts_once() {
    explore(1000, service::a_sealed_request_counts_once);
}

#[test]
fn steps_share_cores() {
    explore(4000, cores::steps_share_cores);
}

#[test]
fn libraries_change_between_steps() {
    let file = file("between-steps.safetensors");
    explore(200, move || reload::libraries_change_between_steps(&file));
}

#[test]
fn one_reload_at_a_time() {
    let file = file("one-reload.safetensors");
    explore(200, move || reload::one_reload_at_a_time(&file));
}
