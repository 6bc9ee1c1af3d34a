//! Vehicles are checked and read by name.
#![allow(clippy::unwrap_used, missing_docs)]

use egp_parameters::VehicleParameters;

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
    for (name, _, value) in listed {
        assert_eq!(table[name].as_float(), Some(value), "{name}");
    }
}

#[test]
fn an_invalid_vehicle_parameter_is_named_in_the_error() {
    for (name, _, _) in CAR.fields() {
        for wrong in ["nan", "inf", "0.0"] {
            assert_eq!(with(name, wrong).validate().unwrap_err().name, name);
        }
    }
    assert_eq!(
        with("a_min", "8.0").validate().unwrap_err().to_string(),
        "vehicle parameter `a_min` must be finite and negative, got 8 m/s²"
    );
    assert_eq!(
        with("mass", "-1.0").validate().unwrap_err().sign,
        "positive"
    );
}

#[test]
fn unknown_and_missing_fields_are_named() {
    let text = toml::to_string(&CAR).unwrap();
    let error = toml::from_str::<VehicleParameters>(&format!("{text}length = 4.3\n"));
    assert!(error.unwrap_err().to_string().contains("length"));
    let error = toml::from_str::<VehicleParameters>(&text.replace("l_r = 1.5\n", ""));
    assert!(error.unwrap_err().to_string().contains("l_r"));
}
