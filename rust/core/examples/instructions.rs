//! One warm control step for instruction counters: 2 members of 700 points, horizon 20, window 10.
//!
//! `instructions write FILE` writes the library, and `instructions FILE` runs the step with it.
//! `tests/bench/instructions.py` runs the latter under callgrind, which counts instructions inside `counted_step` only,
//! not those of loading and warming up.
#![allow(clippy::unwrap_used)]

use std::{env, fs};

use egp_core::{Kernel, Library, Settings, Status, StepReply, StepRequest, Workspace, step};
use egp_testing::{libraries, requests};

/// The function whose instructions are counted; its symbol name must stay.
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
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments
        .iter()
        .map(String::as_str)
        .collect::<Vec<_>>()
        .as_slice()
    {
        ["write", path] => {
            let spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 700, 3);
            fs::write(path, egp_core::library::encode(&spec).unwrap()).unwrap();
        }
        [path] => warm_step(&Library::from_bytes(&fs::read(path).unwrap()).unwrap()),
        _ => eprintln!("usage: instructions [write] FILE; try `instructions write /tmp/library`"),
    }
}

fn warm_step(library: &Library) {
    let settings = requests::settings();
    let mut ws = Workspace::new(library, &settings).unwrap();
    let mut reply = StepReply::default();
    let mut request = requests::Request::circle();
    step(library, &settings, &request.borrow(), &mut ws, &mut reply).unwrap();
    request.carry(&reply);
    request.history_f.drain(..6); // the newest transition is new
    counted_step(library, &settings, &request.borrow(), &mut ws, &mut reply);
    assert_eq!(reply.status, Status::Solved);
    println!("tier {}", tier());
}

/// The instruction set used for the GPs on this machine or simulator; the QP solver uses the baseline.
fn tier() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        return if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl") {
            "avx512"
        } else {
            "avx2"
        };
    }
    "portable"
}
