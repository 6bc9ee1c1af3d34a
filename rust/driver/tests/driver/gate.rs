//! A driver cannot be made with a gate that allows more than the vehicle that the service plans for can do.

use egp_driver::{Driver, DriverConfig, DriverError};
use egp_gate::{GateError, Limits};
use egp_parameters::VehicleParameters;
use egp_wire::Ready;

use crate::world::{CAR, served};

/// The error of a driver with these limits, if there is one.
fn error_with(limits: Limits, vehicle: Option<VehicleParameters>) -> Option<DriverError> {
    let config = DriverConfig::new("depot", "car-7", limits).unwrap();
    let served = Ready {
        vehicle,
        ..served()
    };
    Driver::new(config, served).err()
}

#[test]
fn the_vehicles_own_limits_and_narrower_ones_are_accepted() {
    assert_eq!(error_with(Limits::of(&CAR), Some(CAR)), None);
    let narrow = Limits {
        force_min: -5000.0,
        steering_rate: 0.3,
        ..Limits::of(&CAR)
    };
    assert_eq!(error_with(narrow, Some(CAR)), None);
}

#[test]
fn a_wider_gate_is_an_error_with_both_numbers() {
    let wide = Limits {
        steering_rate: 0.6,
        ..Limits::of(&CAR)
    };
    let error = error_with(wide, Some(CAR)).unwrap();
    assert!(matches!(&error, DriverError::Wider(wider) if wider.name == "steering_rate"));
    let text = error.to_string();
    assert!(
        text.contains("0.6 rad/s") && text.contains("0.4 rad/s"),
        "{text}"
    );
}

#[test]
fn another_mass_is_an_error_with_both_numbers() {
    let light = Limits {
        mass: 1100.0,
        ..Limits::of(&CAR)
    };
    let error = error_with(light, Some(CAR)).unwrap();
    assert!(matches!(&error, DriverError::Wider(wider) if wider.name == "mass"));
    let text = error.to_string();
    assert!(
        text.contains("1100 kg") && text.contains("1225.887 kg"),
        "{text}"
    );
}

#[test]
fn a_service_that_does_not_describe_its_vehicle_sets_no_bound() {
    let wide = Limits {
        steering_rate: 0.6,
        ..Limits::of(&CAR)
    };
    assert_eq!(error_with(wide, None), None);
}

#[test]
fn an_invalid_limit_is_reported_as_such_before_the_comparison() {
    let invalid = Limits {
        force_max: f64::NAN,
        ..Limits::of(&CAR)
    };
    let error = error_with(invalid, Some(CAR)).unwrap();
    assert!(matches!(error, DriverError::Gate(GateError::Limits(_))));
}
