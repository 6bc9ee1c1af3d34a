//! The bounds on the force, and those of the track, that plans keep.
#![allow(clippy::unwrap_used)]

use egp_core::library::encode;
use egp_core::vehicle::ModelParameters;
use egp_core::{Kernel, Library, Status, StepReply, VehicleParameters, Workspace, step};
use egp_testing::libraries;
use egp_testing::requests::{Request, settings, solve};

const CAR: VehicleParameters = VehicleParameters::FORD_ESCORT;

/// The accelerations of a plan that starts at the speed `v_x`, m/s; the reference drives 14 m/s.
fn accelerations(library: &Library, v_x: f64) -> Vec<f64> {
    let mut request = Request::circle();
    request.x[2] = v_x;
    let (settings, mut reply) = (settings(), StepReply::default());
    let mut ws = Workspace::new(library, &settings).unwrap();
    step(library, &settings, &request.borrow(), &mut ws, &mut reply).unwrap();
    let inputs = reply.plan_u.as_chunks::<2>().0;
    inputs.iter().map(|u| u[0] / CAR.mass).collect()
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn the_smaller_bound_of_a_vehicle_that_catches_up_is_also_that_of_members_without_tyres() {
    let constant = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 250, 3);
    let mut kinematic = constant.clone();
    for member in &mut kinematic.members {
        let vehicle = ModelParameters::Kinematic([CAR.mass, CAR.l_f, CAR.l_r]);
        libraries::leave_vehicle(member, vehicle);
    }
    for spec in [constant, kinematic] {
        let library = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
        // Its tyres have no limits of their own: those of the vehicle's actuators take their place.
        for member in library.members() {
            let limits = member.tyre_limits(&CAR);
            assert_eq!((limits.drive, limits.brake), (CAR.a_max, -CAR.a_min));
        }
        // More than 1.5 m/s below the reference, the drive is at most 0.7/1.5 of the largest.
        let drive = largest(&accelerations(&library, 6.0)[..8]);
        assert!((drive - CAR.a_max * 0.7 / 1.5).abs() < 1e-6, "{drive}");
        // Braking has no such bound.
        let brake = -accelerations(&library, 20.0)[3];
        assert!(brake > 0.9 * -CAR.a_min, "{brake}");
    }
}

#[test]
fn on_a_road_with_less_friction_than_all_members_the_plan_brakes_less() {
    let mut request = Request::circle();
    request.x[2] = 20.0;
    let stages = request.reference.len() / 4;
    let mut braking = |friction: f64, std: f64| {
        request.road_friction = [friction, std].repeat(stages + 1);
        let reply = solve(&request, &settings());
        assert_eq!(reply.status, Status::Solved);
        let inputs = reply.plan_u.as_chunks::<2>().0;
        largest(&inputs.iter().map(|u| -u[0] / CAR.mass).collect::<Vec<_>>())
    };
    let most = braking(0.5, 0.0);
    assert!(most > 0.9 * -CAR.a_min, "{most}");
    assert_eq!(
        braking(0.25, 0.2),
        most,
        "the friction may be that of a member"
    );
    assert_eq!(braking(3.0, 0.1), most);
    let less = braking(0.25, 0.0);
    assert!((less - 0.5 * 0.7 / 1.5 * -CAR.a_min).abs() < 1e-6, "{less}");
    assert!(braking(0.25, 0.05) > less);
}

#[test]
fn on_a_track_without_room_for_both_margins_there_is_a_plan() {
    let mut settings = settings();
    settings.horizon = Some(40);
    settings.soft.edge_margin = Some(10.0);
    // The vehicle drives on the centre line, on which the cost is least, so that both edges of a line would be active.
    let mut request = Request::circle_of(40, 0);
    (request.x, request.u_prev) = ([0.0, 0.0, 15.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0]);
    let row = |t: u32| [0.75 * f64::from(t), 0.0, 15.0, 0.0];
    request.reference = (0..=40).flat_map(row).collect();
    request.widths = [3.5, 3.5].repeat(41);
    for _ in 0..3 {
        let reply = solve(&request, &settings);
        assert_eq!(reply.status, Status::Solved);
        request.carry(&reply);
    }
}
