//! Properties that hold for any state, input and surface.

#![allow(missing_docs, clippy::unwrap_used)]

use egp_plant::{
    Contact, Friction, GRAVITY, MAX_SUBSTEP, Plant, PlantError, Surface, Uniform, VehicleId,
    VehicleState, derivative, initial_state, longest_substep,
};
use proptest::prelude::*;

fn plant(vehicle: VehicleId, state: VehicleState) -> Plant {
    let mut plant = Plant::new(vehicle.parameters());
    plant.reset(&state).unwrap();
    plant
}

fn at_speed(v_x: f64) -> VehicleState {
    VehicleState {
        v_x,
        ..VehicleState::default()
    }
}

proptest! {
    #[test]
    fn tyre_force_stays_within_friction(
        slip in -3.0..1.0f64, slip_angle in -1.5..1.5f64, camber in -0.1..0.1f64,
        load in 0.0..9000.0f64, friction in 0.05..1.5f64,
    ) {
        let tyre = VehicleId::FordEscort.parameters().tyre;
        let force = tyre.force(&Contact { slip, slip_angle, camber, load, surface: &friction.into() });
        // The weighting factors exceed 1 because of the shifts; the lateral force also has the vertical shift of 0.04
        // load.
        prop_assert!(force.x.abs() <= 1.02 * friction * load);
        prop_assert!(force.y.abs() <= (1.05 * friction + 0.04) * load);
    }

    #[test]
    fn any_drive_stays_finite_and_within_stops(
        vehicle in prop::sample::select(&VehicleId::ALL[..]),
        v_x in 0.0..40.0f64, delta in -0.9..0.9f64, friction in 0.1..1.3f64,
        inputs in prop::collection::vec((-20_000.0..20_000.0f64, -1.0..1.0f64), 1..20),
    ) {
        let mut plant = plant(vehicle, VehicleState { delta, ..at_speed(v_x) });
        let stop = plant.parameters().limits.steering_angle;
        let surface = Uniform::new(friction).unwrap();
        for (force, rate) in inputs {
            let before = *plant.state();
            match plant.step([force, rate], 0.05, &surface) {
                Ok(()) => prop_assert!(plant.state().iter().all(|value| value.is_finite())),
                Err(error) => {
                    prop_assert!(matches!(error, PlantError::Spun { .. }), "{}", error);
                    prop_assert_eq!(plant.state(), &before);
                }
            }
            prop_assert!(plant.vehicle_state().delta.abs() <= stop);
            prop_assert!(plant.state()[23..27].iter().all(|&wheel| wheel >= 0.0));
        }
    }

    #[test]
    fn motion_does_not_depend_on_place_or_heading(psi in -3.0..3.0f64, p_x in -1e3..1e3f64, p_y in -1e3..1e3f64) {
        let surface = Uniform::new(0.8).unwrap();
        let input = [1500.0, 0.2];
        let mut here = plant(VehicleId::FordEscort, at_speed(15.0));
        let mut there = plant(VehicleId::FordEscort, VehicleState { p_x, p_y, psi, ..at_speed(15.0) });
        here.step(input, 0.5, &surface).unwrap();
        there.step(input, 0.5, &surface).unwrap();
        let (here, there) = (here.vehicle_state(), there.vehicle_state());
        let (sin, cos) = psi.sin_cos();
        prop_assert!((there.p_x - p_x - (cos * here.p_x - sin * here.p_y)).abs() < 1e-9);
        prop_assert!((there.p_y - p_y - (sin * here.p_x + cos * here.p_y)).abs() < 1e-9);
        prop_assert!((there.psi - psi - here.psi).abs() < 1e-9);
        prop_assert!((there.v_y - here.v_y).abs() < 1e-9);
    }
}

#[test]
fn wheel_loads_at_rest_sum_to_the_weight() {
    for vehicle in VehicleId::ALL {
        let parameters = vehicle.parameters();
        let [front, rear] = parameters.static_wheel_loads();
        let unsprung = parameters.front.unsprung_mass + parameters.rear.unsprung_mass;
        let weight = (parameters.sprung.mass + unsprung) * GRAVITY;
        assert!((2.0 * (front + rear) - weight).abs() < 1e-9 * weight);

        let x = initial_state(&parameters, &at_speed(20.0)).unwrap();
        let f = derivative(&parameters, &x, [0.0; 2], &[Surface::from(1.0); 4]).unwrap();
        for vertical in [12, 17, 22] {
            assert!(
                f[vertical].abs() < 1e-9,
                "acceleration {vertical}: {}",
                f[vertical]
            );
        }
    }
}

#[test]
fn substeps_converge_at_fourth_order() {
    // The tyre's shifts jump where the camber changes sign, which does not happen in a steady bend. Halving the step
    // must divide the error by 16; 10 leaves a margin for the next order.
    let surface = Uniform::new(1.0).unwrap();
    let mut bend = plant(
        VehicleId::FordEscort,
        VehicleState {
            delta: 0.02,
            ..at_speed(25.0)
        },
    );
    bend.step([0.0; 2], 2.0, &surface).unwrap();
    let drive = |steps: u32| {
        let mut plant = bend.clone();
        for _ in 0..steps {
            plant
                .step([800.0, 0.1], 0.2 / f64::from(steps), &surface)
                .unwrap();
        }
        plant.vehicle_state()
    };
    let exact = drive(1600);
    let error = |steps| (drive(steps).omega - exact.omega).abs();
    assert!(
        error(50) > 10.0 * error(100),
        "{:e} {:e}",
        error(50),
        error(100)
    );
}

#[test]
fn substeps_shrink_with_speed() {
    let parameters = VehicleId::FordEscort.parameters();
    assert_eq!(longest_substep(&parameters, 30.0, 1.0, 0.0), MAX_SUBSTEP);
    assert!(longest_substep(&parameters, 1.0, 1.0, 0.0) < 5e-4);
    assert_eq!(longest_substep(&parameters, 0.0, 1.0, 0.0), MAX_SUBSTEP);
}

#[test]
fn brakes_stop_and_hold_and_the_vehicle_drives_away_again() {
    let surface = Uniform::new(0.8).unwrap();
    for vehicle in VehicleId::ALL {
        let mut plant = plant(
            vehicle,
            VehicleState {
                delta: 0.05,
                ..at_speed(8.0)
            },
        );
        let mass = plant.parameters().mass;
        for _ in 0..60 {
            plant.step([-6.0 * mass, 0.0], 0.05, &surface).unwrap();
        }
        let parked = plant.vehicle_state();
        assert!(parked.v_x.abs() < 1e-12 && parked.v_y.abs() < 1e-12);
        for _ in 0..200 {
            plant.step([-6.0 * mass, 0.0], 0.05, &surface).unwrap();
        }
        assert!((plant.vehicle_state().p_x - parked.p_x).abs() < 1e-9);
        for _ in 0..20 {
            plant.step([2.0 * mass, 0.0], 0.05, &surface).unwrap();
        }
        let v_x = plant.vehicle_state().v_x;
        assert!((1.8..2.05).contains(&v_x), "{v_x}");
    }
}

#[test]
fn a_vehicle_that_was_braked_to_standstill_has_a_state_that_can_be_set() {
    let surface = Uniform::new(0.8).unwrap();
    for v_x in (0..100).map(|i| 0.5 + 0.05 * f64::from(i)) {
        let mut plant = plant(VehicleId::FordEscort, at_speed(v_x));
        let force = -6.0 * plant.parameters().mass;
        for _ in 0..500 {
            plant.step([force, 0.0], 0.002, &surface).unwrap();
            let state = *plant.state();
            plant.set_state(&state).unwrap();
        }
    }
}

/// Friction coefficients to the left (y > 0) and to the right of the x axis.
struct Split {
    left: f64,
    right: f64,
}

impl Friction for Split {
    fn surface(&self, [_, y]: [f64; 2]) -> Surface {
        if y > 0.0 { self.left } else { self.right }.into()
    }
}

#[test]
fn braking_with_ice_on_the_left_turns_the_vehicle_right() {
    // This checks the wheel order: y is to the left.
    let split = Split {
        left: 0.2,
        right: 1.0,
    };
    for vehicle in VehicleId::ALL {
        let mut plant = plant(vehicle, at_speed(20.0));
        let brake = [-6.0 * plant.parameters().mass, 0.0];
        plant.step(brake, 0.2, &split).unwrap();
        assert!(
            plant.vehicle_state().omega < -0.05,
            "{}",
            plant.vehicle_state().omega
        );
    }
}

#[test]
fn the_same_surface_on_both_sides_is_a_uniform_surface() {
    let split = Split {
        left: 0.7,
        right: 0.7,
    };
    let mut on_split = plant(VehicleId::FordEscort, at_speed(15.0));
    let mut uniform = on_split.clone();
    on_split.step([-2000.0, 0.3], 0.5, &split).unwrap();
    uniform
        .step([-2000.0, 0.3], 0.5, &Uniform::new(0.7).unwrap())
        .unwrap();
    assert_eq!(on_split.state(), uniform.state());
}

#[test]
fn errors_keep_the_state() {
    let surface = Uniform::new(1.0).unwrap();
    let mut plant = plant(VehicleId::FordEscort, at_speed(10.0));
    let before = *plant.state();
    assert!(matches!(
        plant.step([f64::NAN, 0.0], 0.1, &surface),
        Err(PlantError::NotFinite { name: "F_x", .. })
    ));
    assert!(matches!(
        plant.step([0.0, f64::INFINITY], 0.1, &surface),
        Err(PlantError::NotFinite {
            name: "delta_dot",
            ..
        })
    ));
    for dt in [0.0, -0.1, f64::NAN, f64::INFINITY, 2e7] {
        assert!(matches!(
            plant.step([0.0; 2], dt, &surface),
            Err(PlantError::Period(_))
        ));
    }
    assert_eq!(
        plant.reset(&at_speed(-1.0)),
        Err(PlantError::Backward(-1.0))
    );
    assert!(plant.reset(&at_speed(f64::NAN)).is_err());
    assert!(matches!(
        plant.reset(&at_speed(1e9)),
        Err(PlantError::OutOfRange { name: "v_x", .. })
    ));
    let sideways = VehicleState {
        v_y: -50.1,
        ..at_speed(5.0)
    };
    let error = plant.reset(&sideways).unwrap_err();
    assert_eq!(
        error.to_string(),
        "expected v_y from -50 to 50 m/s, got -50.1: check its unit"
    );
    let mut fast = before;
    fast[3] = 100.1;
    assert!(matches!(
        plant.set_state(&fast),
        Err(PlantError::OutOfRange { name: "v_x", .. })
    ));
    assert!(plant.set_state(&[f64::NAN; 29]).is_err());
    assert_eq!(plant.state(), &before);

    let mut broken = before;
    broken[12] = 1e308;
    plant.set_state(&broken).unwrap();
    assert!(matches!(
        plant.step([0.0; 2], 0.05, &surface),
        Err(PlantError::Diverged { .. })
    ));
    assert_eq!(plant.state(), &broken);
    assert_eq!(VehicleId::try_from(0), Err(PlantError::UnknownVehicle(0)));
}

/// A controller's numbers are the simulated vehicle's, rounded, and its limits lie inside.
#[test]
fn controllers_know_the_vehicles_that_are_simulated() {
    for id in VehicleId::ALL {
        let (known, plant) = (id.vehicle(), id.parameters());
        known.validate().unwrap();
        for (rounded, exact, tolerance) in [
            (known.mass, plant.mass, 1e-6),
            (known.yaw_inertia, plant.yaw_inertia, 1e-6),
            (known.l_f, plant.front.position, 0.02),
            (known.l_r, -plant.rear.position, 0.01),
            (
                known.power,
                plant.limits.acceleration * plant.limits.switch_speed,
                0.4,
            ),
        ] {
            assert!(
                (rounded / exact - 1.0).abs() < tolerance,
                "{id:?} {rounded} {exact}"
            );
        }
        assert!(
            known.a_max < plant.limits.acceleration && -known.a_min < plant.limits.acceleration
        );
        assert!(known.steering_angle <= plant.limits.steering_angle);
        assert!(known.steering_rate <= plant.limits.steering_rate);
        let force = |slip_angle: f64| {
            let contact = Contact {
                slip: 0.0,
                slip_angle,
                camber: 0.0,
                load: 3000.0,
                surface: &Surface::from(1.0),
            };
            plant.tyre.force(&contact).y.abs()
        };
        let peak = (0..300)
            .map(|i| force(1e-3 * f64::from(i)))
            .fold(0.0, f64::max);
        assert!(force(known.peak_slip) > 0.99 * peak);
    }
}
