//! Disturbances against calculations by hand.

#![allow(missing_docs, clippy::unwrap_used)]

use egp_plant::{
    Disturbances, GRAVITY, Parameters, Plant, PlantError, Surface, Uniform, VehicleId, VehicleState,
};

fn surface() -> Uniform {
    Uniform::new(Surface::DRY).unwrap()
}

fn escort() -> Parameters {
    VehicleId::FordEscort.parameters()
}

fn plant(v_x: f64, disturbances: Disturbances) -> Plant {
    let mut plant = Plant::new(escort());
    plant.disturb(&disturbances).unwrap();
    plant
        .reset(&VehicleState {
            v_x,
            ..VehicleState::default()
        })
        .unwrap();
    plant
}

/// Load under each wheel, N: front right, front left, rear right, rear left.
fn loads(plant: &Plant) -> [f64; 4] {
    let (p, x) = (plant.parameters(), plant.state());
    let load = |axle: usize, half: f64| {
        let (roll, z) = (x[13 + 5 * axle], x[16 + 5 * axle]);
        (z + p.wheel.radius * (roll.cos() - 1.0) + half * roll.sin()) * p.wheel.vertical_stiffness
    };
    let [front, rear] = p.axles().map(|axle| 0.5 * axle.track_width);
    [
        load(0, -front),
        load(0, front),
        load(1, -rear),
        load(1, rear),
    ]
}

fn settled(disturbances: Disturbances) -> Plant {
    let mut plant = plant(0.0, disturbances);
    plant.step([0.0; 2], 6.0, &surface()).unwrap();
    plant
}

fn close(value: f64, expected: f64, tolerance: f64) {
    assert!(
        (value - expected).abs() <= tolerance * expected.abs(),
        "{value} {expected}"
    );
}

#[test]
fn without_disturbances_nothing_changes() {
    let mut disturbed = plant(15.0, Disturbances::default());
    let mut free = Plant::new(escort());
    free.reset(&disturbed.vehicle_state()).unwrap();
    for rate in [0.2, -0.3] {
        disturbed.step([-2000.0, rate], 0.3, &surface()).unwrap();
        free.step([-2000.0, rate], 0.3, &surface()).unwrap();
    }
    assert_eq!(disturbed.state(), free.state());
    assert_eq!(
        disturbed.lateral_acceleration(),
        free.lateral_acceleration()
    );
}

#[test]
fn a_grade_decelerates_a_coasting_vehicle_and_lightens_it() {
    let grade = 0.1_f64;
    let speed_after_a_second = |grade| {
        let mut plant = plant(
            15.0,
            Disturbances {
                grade,
                ..Disturbances::default()
            },
        );
        plant.step([0.0; 2], 1.0, &surface()).unwrap();
        plant.vehicle_state().v_x
    };
    // The four wheels turn slower, too, so that their inertia acts like a mass.
    let p = escort();
    let wheels = 4.0 * p.wheel.inertia / p.wheel.radius.powi(2);
    let expected = GRAVITY * grade.sin() * p.mass / (p.mass + wheels);
    let level = speed_after_a_second(0.0);
    close(level - speed_after_a_second(grade), expected, 0.01);
    close(speed_after_a_second(-grade) - level, expected, 0.01);

    let sum: f64 = loads(&settled(Disturbances {
        grade,
        bank: 0.2,
        ..Disturbances::default()
    }))
    .iter()
    .sum();
    close(sum, p.mass * GRAVITY * grade.cos() * 0.2_f64.cos(), 0.01);
}

#[test]
fn a_vehicle_on_a_slope_neither_rolls_backward_nor_slips_through_its_brakes() {
    let on = |grade: f64, force: f64| {
        let disturbances = Disturbances {
            grade,
            ..Disturbances::default()
        };
        let mut plant = plant(0.0, disturbances);
        plant.step([force, 0.0], 2.0, &surface()).unwrap();
        plant.vehicle_state()
    };
    let brake = -2.0 * escort().mass;
    assert!(on(0.1, 0.0).v_x.abs() < 1e-9 && on(0.1, 0.0).p_x.abs() < 1e-9);
    assert!(on(-0.1, brake).v_x.abs() < 1e-9 && on(-0.1, brake).p_x.abs() < 1e-9);
    close(on(-0.1, 0.0).v_x, 2.0 * GRAVITY * 0.1_f64.sin(), 0.1);
}

#[test]
fn a_bank_pulls_down_the_slope() {
    let mut plant = plant(
        15.0,
        Disturbances {
            bank: 0.05,
            ..Disturbances::default()
        },
    );
    plant.step([0.0; 2], 1e-3, &surface()).unwrap();
    close(
        plant.vehicle_state().v_y,
        -1e-3 * GRAVITY * 0.05_f64.sin(),
        0.05,
    );
    plant.step([0.0; 2], 1.0, &surface()).unwrap();
    assert!(plant.vehicle_state().p_y < -0.02);
}

#[test]
fn a_load_weighs_on_its_side_and_its_axle() {
    let (mass, x, y) = (200.0, 0.5, 0.4);
    let before = loads(&settled(Disturbances::default()));
    let after = settled(Disturbances {
        load: mass,
        load_x: x,
        load_y: y,
        ..Disturbances::default()
    });
    let more: Vec<f64> = loads(&after)
        .iter()
        .zip(before)
        .map(|(a, b)| a - b)
        .collect();
    let p = escort();
    close(more.iter().sum(), mass * GRAVITY, 0.01);
    // The lever between the axles.
    let front = mass * GRAVITY * (x - p.rear.position) / p.wheelbase();
    close(more[0] + more[1], front, 0.02);
    assert!(more[1] > more[0] && more[3] > more[2]);
    // Springs and anti-roll bars balance the load's moment and that of the body, which leans to the left, too. The tyres'
    // camber forces, which the standing vehicle does not follow, are in the lateral acceleration. The height of the body
    // above the roll axis is a little smaller than its height at rest.
    let x = after.state();
    let sprung = p.sprung.mass + mass;
    let balance: f64 = p
        .axles()
        .into_iter()
        .zip([13, 18])
        .map(|(axle, roll)| {
            (0.5 * axle.spring * axle.track_width.powi(2) - axle.torsion) * (x[6] - x[roll])
        })
        .sum();
    close(
        balance,
        GRAVITY * mass * y
            + sprung * p.sprung.height * (GRAVITY * x[6].sin() - after.lateral_acceleration()),
        0.05,
    );
    // Positive pitch is nose up.
    assert!(x[8] < settled(Disturbances::default()).state()[8] - 0.01);
}

#[test]
fn braking_with_a_load_on_the_left_turns_right_and_accelerates_less() {
    let mut loaded = plant(
        20.0,
        Disturbances {
            load: 200.0,
            load_y: 0.6,
            ..Disturbances::default()
        },
    );
    let mut coasting = loaded.clone();
    let mut free = plant(20.0, Disturbances::default());
    let brake = [-5.0 * escort().mass, 0.0];
    for (plant, input) in [
        (&mut loaded, brake),
        (&mut free, brake),
        (&mut coasting, [0.0; 2]),
    ] {
        plant.step(input, 0.5, &surface()).unwrap();
    }
    assert!(loaded.vehicle_state().omega < coasting.vehicle_state().omega - 0.01);
    let lost = |plant: &Plant| 20.0 - plant.vehicle_state().v_x;
    let mass = escort().mass;
    close(lost(&loaded) / lost(&free), mass / (mass + 200.0), 0.02);
}

#[test]
fn worn_rear_tyres_make_the_vehicle_turn_more_and_worn_front_tyres_less() {
    let yaw_rate = |wear_front, wear_rear| {
        let mut plant = plant(
            15.0,
            Disturbances {
                wear_front,
                wear_rear,
                ..Disturbances::default()
            },
        );
        plant.step([0.0, 0.1], 0.2, &surface()).unwrap();
        plant.step([0.0; 2], 1.5, &surface()).unwrap();
        plant.vehicle_state().omega
    };
    let new = yaw_rate(0.0, 0.0);
    assert!(yaw_rate(0.0, 0.4) > 1.05 * new);
    assert!(yaw_rate(0.4, 0.0) < 0.95 * new);
}

#[test]
fn brake_bias_and_pull_distribute_the_torque() {
    let p = escort();
    // In the first instant, rolling wheels slow down in proportion to their torque.
    let slowed = |disturbances| {
        let mut plant = plant(20.0, disturbances);
        let before = *plant.state();
        plant.step([-3.0 * p.mass, 0.0], 1e-5, &surface()).unwrap();
        [23, 24, 25, 26].map(|wheel| before[wheel] - plant.state()[wheel])
    };
    let coasting = {
        let mut plant = plant(20.0, Disturbances::default());
        let before = *plant.state();
        plant.step([0.0; 2], 1e-5, &surface()).unwrap();
        [23, 24, 25, 26].map(|wheel| before[wheel] - plant.state()[wheel])
    };
    let even = slowed(Disturbances::default());
    let biased = slowed(Disturbances {
        brake_bias: 0.1,
        ..Disturbances::default()
    });
    let pulled = slowed(Disturbances {
        brake_pull: 0.3,
        ..Disturbances::default()
    });
    let factors = [
        (p.front.brake_share + 0.1) / p.front.brake_share,
        (p.rear.brake_share - 0.1) / p.rear.brake_share,
    ];
    for wheel in 0..4 {
        let own = even[wheel] - coasting[wheel];
        close(
            biased[wheel] - coasting[wheel],
            factors[wheel / 2] * own,
            0.01,
        );
        let side = if wheel % 2 == 1 { 1.3 } else { 0.7 };
        close(pulled[wheel] - coasting[wheel], side * own, 0.01);
    }
    let mut plant = plant(
        20.0,
        Disturbances {
            brake_pull: 0.3,
            ..Disturbances::default()
        },
    );
    plant.step([-3.0 * p.mass, 0.0], 0.3, &surface()).unwrap();
    assert!(plant.vehicle_state().omega > 0.02); // to the left
    plant.step([0.0; 2], 0.1, &surface()).unwrap();
}

#[test]
fn crosswind_pushes_and_a_headwind_does_not() {
    let wind = |wind_x, wind_y, wind_arm| Disturbances {
        wind_x,
        wind_y,
        wind_arm,
        ..Disturbances::default()
    };
    // 1/2 * 1.225 kg/m³ * 4.2 m² * sqrt(20² + 15²) m/s * 15 m/s.
    let force = 0.5 * 1.225 * 4.2 * 25.0 * 15.0;
    let mut from_the_right = plant(20.0, wind(0.0, 15.0, 0.0));
    close(
        from_the_right.lateral_acceleration(),
        force / escort().sprung.mass,
        1e-9,
    );
    from_the_right.step([0.0; 2], 2.0, &surface()).unwrap();
    assert!(from_the_right.vehicle_state().p_y > 0.1);
    let mut headwind = plant(20.0, wind(-15.0, 0.0, 0.5));
    let mut calm = plant(20.0, Disturbances::default());
    headwind.step([0.0; 2], 1.0, &surface()).unwrap();
    calm.step([0.0; 2], 1.0, &surface()).unwrap();
    let drift = headwind.vehicle_state().p_y - calm.vehicle_state().p_y;
    assert!(drift.abs() < 1e-3, "{drift}");
    // Ahead of the centre of mass the wind also turns the vehicle; at first by F arm / I.
    let mut gust = plant(20.0, wind(0.0, 15.0, 0.5));
    gust.step([0.0; 2], 1e-3, &surface()).unwrap();
    close(
        gust.vehicle_state().omega,
        1e-3 * force * 0.5 / escort().yaw_inertia,
        0.05,
    );
}

#[test]
fn a_disturbance_out_of_range_is_an_error_and_changes_nothing() {
    let mut plant = plant(10.0, Disturbances::default());
    for (disturbances, field) in [
        (
            Disturbances {
                load: -1.0,
                ..Default::default()
            },
            "load",
        ),
        (
            Disturbances {
                load_y: 2.0,
                ..Default::default()
            },
            "load_y",
        ),
        (
            Disturbances {
                wear_front: 1.0,
                ..Default::default()
            },
            "wear_front",
        ),
        (
            Disturbances {
                brake_bias: 0.9,
                ..Default::default()
            },
            "brake_bias",
        ),
        (
            Disturbances {
                brake_pull: -1.1,
                ..Default::default()
            },
            "brake_pull",
        ),
        (
            Disturbances {
                wind_y: f64::NAN,
                ..Default::default()
            },
            "wind_y",
        ),
        (
            Disturbances {
                grade: 0.6,
                ..Default::default()
            },
            "grade",
        ),
        (
            Disturbances {
                bank: f64::INFINITY,
                ..Default::default()
            },
            "bank",
        ),
    ] {
        let error = plant.disturb(&disturbances).unwrap_err();
        assert!(
            matches!(error, PlantError::OutOfRange { name, .. } if name == format!("disturbance {field}")),
            "{error}"
        );
    }
    let mut free = Plant::new(escort());
    free.reset(&plant.vehicle_state()).unwrap();
    plant.step([500.0, 0.1], 0.2, &surface()).unwrap();
    free.step([500.0, 0.1], 0.2, &surface()).unwrap();
    assert_eq!(plant.state(), free.state());
}
