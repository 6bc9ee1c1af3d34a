//! Vehicles are checked and read by name.
#![allow(clippy::unwrap_used, missing_docs)]

use egp_parameters::{FULL_SIZE, VehicleParameters, slip_speed};

const CAR: VehicleParameters = VehicleParameters::FORD_ESCORT;

/// The car with one field changed, by way of its text form.
fn with(name: &str, value: &str) -> VehicleParameters {
    let line = |text: String| match text.split_once(" = ") {
        Some((field, _)) if field == name => format!("{name} = {value}"),
        _ => text,
    };
    let text = toml::to_string(&CAR).unwrap();
    let lines: Vec<String> = text.lines().map(|text| line(text.to_owned())).collect();
    toml::from_str(&lines.join("\n")).unwrap()
}

#[test]
fn the_known_vehicles_are_valid() {
    CAR.validate().unwrap();
    VehicleParameters::BMW_320I.validate().unwrap();
}

#[test]
fn every_field_is_listed_under_its_name() {
    let table: toml::Table = toml::from_str(&toml::to_string(&CAR).unwrap()).unwrap();
    let listed = CAR.fields();
    assert_eq!(table.len(), listed.len());
    for ((name, _, value), (same, least, most)) in
        listed.into_iter().zip(VehicleParameters::ranges())
    {
        assert_eq!(table[name].as_float(), Some(value), "{name}");
        assert!(name == same && least < most, "{name}");
    }
}

#[test]
fn a_parameter_in_another_unit_is_named_in_the_error() {
    for (name, _, value) in CAR.fields() {
        let opposite = (-value).to_string();
        for wrong in ["nan", "inf", "0.0", "1e200", "1e-200", &opposite] {
            assert_eq!(with(name, wrong).validate().unwrap_err().name, name);
        }
    }
    for (name, wrong) in [
        ("mass", "0.9"),
        ("l_f", "900.0"),
        ("l_r", "20.1"),
        ("width", "50.0"),
        ("a_min", "-1000.0"),
        ("power", "0.001"),
        ("a_slew", "1e-3"),
        ("steering_angle", "45.0"),
        ("steering_slew", "1e-3"),
        ("peak_slip", "100.0"),
        ("driving_grip", "9.0"),
    ] {
        assert_eq!(with(name, wrong).validate().unwrap_err().name, name);
    }
    assert_eq!(
        with("a_min", "8.0").validate().unwrap_err().to_string(),
        "vehicle parameter `a_min` is 8.0 m/s²: expected -50 to -0.01; check its unit"
    );
}

#[test]
fn the_yaw_inertia_fits_the_mass_and_the_axles() {
    let error = with("yaw_inertia", "1.5").validate().unwrap_err();
    let message = error.to_string();
    assert_eq!(error.name, "yaw_inertia");
    assert!(
        message.ends_with("for this mass and these distances to the axles; check its unit"),
        "{message}"
    );
    assert_eq!(
        with("yaw_inertia", "5e4").validate().unwrap_err().name,
        "yaw_inertia"
    );
}

#[test]
fn model_cars_karts_lorries_and_racing_cars_are_vehicles() {
    let model = VehicleParameters {
        mass: 3.74,
        yaw_inertia: 0.047,
        l_f: 0.159,
        l_r: 0.171,
        width: 0.27,
        ..CAR
    };
    let kart = VehicleParameters {
        mass: 250.0,
        yaw_inertia: 90.0,
        l_f: 0.55,
        l_r: 0.5,
        a_slew: 200.0,
        ..CAR
    };
    let lorry = VehicleParameters {
        mass: 4e4,
        yaw_inertia: 4e5,
        l_f: 3.0,
        l_r: 3.5,
        power: 8.0,
        ..CAR
    };
    let racing = VehicleParameters {
        power: 1000.0,
        lateral_grip: 3.5,
        braking_grip: 4.0,
        a_min: -50.0,
        ..CAR
    };
    for vehicle in [model, kart, lorry, racing] {
        vehicle.validate().unwrap();
    }
}

#[test]
fn the_slip_speed_of_small_vehicles_follows_froudes_law() {
    assert_eq!((CAR.scale(), CAR.slip_speed()), (1.0, 3.0));
    assert_eq!(slip_speed(FULL_SIZE), 3.0);
    // A car of a quarter of the size drives at half the speed.
    assert_eq!(slip_speed(FULL_SIZE / 4.0), 1.5);
}

#[test]
fn unknown_and_missing_fields_are_named() {
    let text = toml::to_string(&CAR).unwrap();
    let error = toml::from_str::<VehicleParameters>(&format!("{text}length = 4.3\n"));
    assert!(error.unwrap_err().to_string().contains("length"));
    let error = toml::from_str::<VehicleParameters>(&text.replace("l_r = 1.5\n", ""));
    assert!(error.unwrap_err().to_string().contains("l_r"));
}
