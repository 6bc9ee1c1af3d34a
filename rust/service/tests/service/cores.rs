//! An engine on several cores replies with the same bytes as one on a single core, whether or not others use the cores.
#![allow(clippy::unwrap_used)]

use std::thread;

use egp_core::{Kernel, Settings};
use egp_driver::Carry;
use egp_engine::Engine;
use egp_testing::libraries;
use egp_wire::Status;

fn engine() -> Engine {
    let frictions: Vec<f64> = (0..8).map(|i| 0.4 + 0.1 * f64::from(i)).collect();
    let library = libraries::library(Kernel::Rbf, &frictions, 500, 3);
    let settings = Settings {
        horizon: Some(20),
        ..Settings::default()
    };
    Engine::new(library, settings).unwrap()
}

#[test]
fn replies_are_the_same_bytes_on_any_number_of_cores() {
    let alone = engine();
    let mut request = crate::loopback::request(&mut Carry::new(alone.library().id(), 10));
    request.want_sigma = true;
    let request = request.encode();
    let reply = |engine: &Engine| {
        let mut reply = Vec::new();
        let mut workspace = engine.workspace().unwrap();
        let status = engine.step(&mut workspace, &request, &mut reply).unwrap();
        assert_eq!(status, Status::Solved);
        reply
    };
    let expected = reply(&alone);
    let shared = alone.with_cores(usize::MAX).unwrap();
    thread::scope(|scope| {
        // A single step can borrow cores; four steps at once cannot.
        for at_once in [1, 4] {
            let steps: Vec<_> = (0..at_once)
                .map(|_| scope.spawn(|| reply(&shared)))
                .collect();
            for step in steps {
                assert_eq!(step.join().unwrap(), expected);
            }
        }
    });
}
