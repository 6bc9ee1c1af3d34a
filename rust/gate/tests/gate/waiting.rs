//! A gate whose first plan has not been driven yet.
#![allow(clippy::unwrap_used)]

use egp_gate::{Gate, Mode};

use crate::properties::{DT, LIMITS};

#[test]
fn before_the_first_plan_the_vehicle_waits_braked_and_the_plan_ends_the_wait() {
    let mut gate = Gate::new(LIMITS, DT, 5, 3.0).unwrap();
    assert_eq!(gate.mode(), Mode::Waiting);
    for tick in 0..10 {
        let command = gate.command(tick, 10.0, 0.0);
        assert_eq!((command.mode, command.u[1]), (Mode::Waiting, 0.0));
        assert!(command.u[0] < 0.0);
    }
    gate.accept(10, &[[10.0, 0.0]]).unwrap();
    assert_eq!(gate.command(10, 10.0, 0.0).mode, Mode::Normal);
    gate.reset();
    assert_eq!(gate.command(11, 10.0, 0.0).mode, Mode::Waiting);
}

#[test]
fn a_first_plan_that_comes_too_late_does_not_stop_the_vehicle() {
    for (max_tail, length) in [(2, 9), (9, 3), (0, 9)] {
        let mut gate = Gate::new(LIMITS, DT, max_tail, 3.0).unwrap();
        for start in [0, 100] {
            for tick in start..start + 5 {
                assert_eq!(gate.command(tick, 10.0, 0.0).mode, Mode::Waiting);
            }
            // It was made for the first of these periods.
            gate.accept(start, &vec![[10.0, 0.0]; length]).unwrap();
            let command = gate.command(start + 5, 10.0, 0.0);
            assert_eq!((command.mode, command.u[1]), (Mode::Waiting, 0.0));
            assert!(command.u[0] < 0.0);
            gate.accept(start + 6, &[[10.0, 0.0]; 2]).unwrap();
            assert_eq!(gate.command(start + 6, 10.0, 0.0).mode, Mode::Normal);
            gate.reset();
        }
    }
}

#[test]
fn a_gate_that_has_stopped_does_not_wait_although_no_plan_has_come() {
    let mut gate = Gate::new(LIMITS, DT, 5, 3.0).unwrap();
    gate.stop();
    assert_eq!(gate.command(0, 10.0, 0.0).mode, Mode::Stop);
    assert_eq!(gate.command(1, 10.0, 0.0).mode, Mode::Stop);
    gate.reset();
    assert_eq!(gate.command(2, f64::NAN, 0.0).mode, Mode::Stop);
    assert_eq!(gate.command(3, 10.0, 0.0).mode, Mode::Stop);
}
