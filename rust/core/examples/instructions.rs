//! One warm control step for instruction counters, and what a vehicle computes beside it: 2 members, one kernel.
//!
//! `instructions write FILE POINTS` writes a library whose members have so many points. `instructions FILE HORIZON WINDOW`
//! runs the step with it, then plans the speed of a period for the friction that is believed, first without and then with
//! reports of other vehicles, and last runs the step with the friction of the road ahead in its request.
//! `tests/bench/instructions.py` runs this under callgrind, which counts the instructions of each call of `counted`, not
//! those of loading and warming up.
#![allow(clippy::unwrap_used)]

use std::{env, fs};

use egp_core::{Kernel, Library, Status, StepReply, StepRequest, Workspace, step};
use egp_testing::planning::Planning;
use egp_testing::{libraries, requests};

/// Instructions are counted inside this function; its symbol name must stay.
#[inline(never)]
fn counted(work: &mut dyn FnMut()) {
    work();
}

fn main() {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments
        .iter()
        .map(String::as_str)
        .collect::<Vec<_>>()
        .as_slice()
    {
        ["write", path, points] => {
            let spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], points.parse().unwrap(), 3);
            fs::write(path, egp_core::library::encode(&spec).unwrap()).unwrap();
        }
        [path, horizon, window] => {
            let library = Library::from_bytes(&fs::read(path).unwrap()).unwrap();
            period(&library, horizon.parse().unwrap(), window.parse().unwrap());
        }
        _ => {
            eprintln!("usage: instructions write FILE POINTS, or instructions FILE HORIZON WINDOW");
        }
    }
}

fn period(library: &Library, horizon: u32, window: u32) {
    egp_core::count_with_baseline_qp();
    let mut settings = requests::settings();
    settings.horizon = Some(horizon as usize);
    settings.weights.window = Some(window as usize);
    // Stated, so that other defaults, with which this problem takes other iterations, do not change the counts.
    (settings.cost.longitudinal, settings.cost.lateral) = (Some(10.0), Some(60.0));
    let mut ws = Workspace::new(library, &settings).unwrap();
    let mut reply = StepReply::default();
    let mut request = requests::Request::circle_of(horizon, window);
    step(library, &settings, &request.borrow(), &mut ws, &mut reply).unwrap();
    request.carry(&reply);
    request.history_f.drain(..6); // the newest transition is new
    let mut solve = |request: StepRequest| {
        counted(&mut || step(library, &settings, &request, &mut ws, &mut reply).unwrap());
        assert_eq!(reply.status, Status::Solved);
    };
    solve(request.borrow());
    for reports in [false, true] {
        let mut planning = Planning::new(horizon as usize, reports);
        counted(&mut || {
            planning.period();
        });
        request.road_friction = planning.preview().as_flattened().to_vec();
    }
    solve(request.borrow());
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
