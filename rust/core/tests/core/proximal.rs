//! The proximal term on the force: consecutive plans for one state converge at the end of the grip.
#![allow(clippy::unwrap_used)]

use egp_core::library::encode;
use egp_core::solver::{ClarabelSolver, RiccatiSolver};
use egp_core::vehicle::ModelParameters;
use egp_core::{Input, Kernel, Library, Settings, Status, StepReply, VehicleParameters, step};
use egp_core::{OcpSolution, QpSolver, Workspace};
use egp_testing::drives::Drive;
use egp_testing::libraries;
use egp_testing::requests::Request;

/// Mass of the vehicle that the tests' library is for, kg.
const MASS: f64 = VehicleParameters::FORD_ESCORT.mass;

/// A library of one vehicle on friction 1, whose braking costs lateral force at the front and whose drive at the rear.
fn fitted() -> Library {
    let mut spec = libraries::spec(Kernel::Rbf, &[1.0], 20, 0);
    let vehicle = ModelParameters::SingleTrack([
        1225.0, 0.9, 1.5, 1.6, 0.5, 0.5, 0.8, 0.3, 2.2, 0.9, 16.5, 1.4, 2.2, 0.3, 1.0, 25.0, 1.1,
    ]);
    libraries::leave_vehicle(&mut spec.members[0], vehicle);
    Library::from_bytes(&encode(&spec).unwrap()).unwrap()
}

/// Forces of the first input, F_x / m in m/s², of ten plans for one state on a circle with 97 % of the grip, each of which
/// is linearised along the one before.
fn forces(proximal: f64) -> Vec<f64> {
    let library = fitted();
    let mut settings = Settings {
        horizon: Some(20),
        ..Settings::default()
    };
    settings.cost.proximal = proximal;
    let (radius, speed, dt) = (30.0_f64, 16.0, library.dt());
    let mut request = Request::circle();
    (request.history_z, request.history_y) = (vec![], vec![]);
    request.widths.clear();
    request.plan_shift = 0;
    request.x = [0.0, -0.5, speed, 0.0, 0.2, speed / radius, 0.1];
    request.u_prev = [0.0, 0.0];
    request.reference = (0..=20)
        .flat_map(|t| {
            let angle = speed * dt * f64::from(t) / radius;
            let (sin, cos) = angle.sin_cos();
            [radius * sin, radius * (1.0 - cos), speed, angle]
        })
        .collect();
    let mut ws = Workspace::new(&library, &settings).unwrap();
    let mut reply = StepReply::default();
    (0..10)
        .map(|_| {
            step(&library, &settings, &request.borrow(), &mut ws, &mut reply).unwrap();
            assert_eq!(reply.status, Status::Solved);
            request.carry(&reply);
            reply.plan_u[0] / MASS
        })
        .collect()
}

#[test]
fn consecutive_plans_converge_at_the_end_of_the_grip_and_alternate_without_the_term() {
    let change = |forces: &[f64]| (forces[9] - forces[8]).abs();
    let (with, without) = (forces(2.0), forces(0.0));
    assert!(change(&with) < 0.2, "{with:.2?}");
    assert!(change(&without) > 1.0, "{without:.2?}");
}

#[test]
fn a_heavy_term_holds_the_force_of_the_previous_plan() {
    let mut drive = Drive::new(3);
    let mut qp = drive.problem(20);
    let settings = Settings::default().solver;
    let mut riccati = RiccatiSolver::new(20, &settings);
    let mut clarabel = ClarabelSolver::new(&qp, &settings).unwrap();
    let mut solution = OcpSolution::new(20);
    assert_eq!(riccati.solve(&qp, &[], &mut solution), Status::Solved);
    let free = solution.u.clone();
    // A tenth less than the solution without the term.
    for (stage, u) in qp.stages_mut().iter_mut().zip(&free) {
        (stage.proximal, stage.planned) = (Input::new(1e4, 0.0), u * 0.9);
    }
    for solver in [&mut riccati as &mut dyn QpSolver, &mut clarabel] {
        assert_eq!(solver.solve(&qp, &[], &mut solution), Status::Solved);
        qp.check(&mut solution);
        assert!(solution.kkt.worst() < 1e-5, "{:?}", solution.kkt);
        for (u, free) in solution.u.iter().zip(&free) {
            assert!((u[0] - 0.9 * free[0]).abs() < 0.05, "{u:?} {free:?}");
        }
    }
}
