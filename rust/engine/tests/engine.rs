//! What an engine cannot be made of.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::Path;

use egp_core::library::encode;
use egp_core::settings::{InputBounds, Operating};
use egp_core::{Kernel, Library, Settings};
use egp_engine::{Engine, EngineError};
use egp_testing::{libraries, requests};
use egp_wire::{Predictions, Request, Status};

fn bytes() -> Vec<u8> {
    encode(&libraries::spec(Kernel::Rbf, &[0.5, 1.1], 20, 0)).unwrap()
}

/// The engine of a library's vehicle with this strongest drive, m/s², in settings that state this mass, kg, and limits.
fn of_mass(mass: f64, strongest: f64, limits: InputBounds) -> Result<Engine, EngineError> {
    let mut spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 20, 0);
    spec.parameters.a_max = strongest;
    let settings = Settings {
        mass: Some(mass),
        limits,
        ..Settings::default()
    };
    let library = Library::from_bytes(&encode(&spec).unwrap()).unwrap();
    Engine::new(library, settings)
}

#[test]
fn forces_that_no_message_can_carry_are_an_error() {
    let bounds = |a_max| InputBounds {
        a_max: Some(a_max),
        ..InputBounds::default()
    };
    assert!(of_mass(20e3, 6.0, bounds(50.0)).is_ok());
    let error = of_mass(22e3, 6.0, bounds(50.0)).unwrap_err();
    assert!(matches!(error, EngineError::Force { force, .. } if force == 50.0 * 22e3));
    let text = error.to_string();
    for part in ["1100000 N", "22000 kg", "50 m/s²", "at most 1000000 N"] {
        assert!(text.contains(part), "{text}");
    }
    // Plans within narrow limits are no error by themselves, but clients drive within those of the library.
    let error = of_mass(22e3, 50.0, bounds(1.0)).unwrap_err();
    assert!(matches!(error, EngineError::Force { force, .. } if force == 50.0 * 22e3));
}

#[test]
fn a_mass_that_does_not_fit_the_inertia_of_the_library_is_an_error() {
    let error = of_mass(126e3, 6.0, InputBounds::default()).unwrap_err();
    assert!(matches!(error, EngineError::Vehicle(fault) if fault.name == "mass"));
    let error = of_mass(50e3, 6.0, InputBounds::default()).unwrap_err();
    assert!(matches!(error, EngineError::Vehicle(fault) if fault.name == "yaw_inertia"));
    let text = error.to_string();
    assert!(
        text.starts_with("with the mass and the front axle of the settings"),
        "{text}"
    );
}

#[test]
fn a_slip_that_is_never_reached_switches_the_bound_off_and_is_not_the_vehicles() {
    let settings = Settings::from_toml("[soft]\nslip = 5.0").unwrap();
    let engine = Engine::new(Library::from_bytes(&bytes()).unwrap(), settings).unwrap();
    assert_eq!(engine.vehicle(), *engine.library().vehicle());
}

#[test]
fn errors_name_the_file_of_the_library() {
    let path = Path::new("folder/some.safetensors");
    let load = |content: &[u8], settings| {
        let error = Engine::from_bytes(path, content, settings).unwrap_err();
        error.to_string()
    };
    let horizon = |horizon| Settings {
        horizon: Some(horizon),
        ..Settings::default()
    };
    let heavy = Settings {
        mass: Some(50e3),
        ..Settings::default()
    };
    for (text, reason) in [
        (load(&bytes()[1..], Settings::default()), "header"),
        (load(&bytes(), horizon(150)), "settings.horizon is 150"),
        (load(&bytes(), horizon(0)), "setting `horizon`"),
        (load(&bytes(), heavy), "`yaw_inertia`"),
    ] {
        assert!(text.starts_with("folder/some.safetensors "), "{text}");
        assert!(text.contains(reason), "{text}");
    }
    let missing = Engine::load(path, Settings::default()).unwrap_err();
    let text = missing.to_string();
    assert!(text.contains("folder/some.safetensors: "), "{text}");
    assert!(text.ends_with("which `egp train` makes"), "{text}");
}

/// A request of the wire for [`requests::settings`] with the library of [`requests::library`].
fn message(request: &requests::Request, library: [u8; 32]) -> Vec<u8> {
    Request {
        library,
        sequence: 1,
        budget_us: 40_000,
        x: request.x,
        u_prev: request.u_prev,
        weights: request.weights.clone(),
        plan_x: request.plan_x.as_chunks().0.to_vec(),
        plan_u: request.plan_u.as_chunks().0.to_vec(),
        plan_shift: request.plan_shift,
        history_z: request.history_z.as_chunks().0.to_vec(),
        history_y: request.history_y.as_chunks().0.to_vec(),
        reference: request.reference.as_chunks().0.to_vec(),
        widths: request.widths.as_chunks().0.to_vec(),
        ..Request::default()
    }
    .encode()
}

#[test]
fn a_history_of_another_number_of_members_is_an_error() {
    let library = libraries::library(Kernel::Rbf, &[0.5, 1.1], 50, 3);
    let engine = Engine::new(library, requests::settings()).unwrap();
    let mut workspace = engine.workspace().unwrap();
    let warm = requests::warm();
    let bytes = message(&warm, engine.library().id());
    let mut request = Request::decode(&bytes).unwrap();
    request.weights.clear();
    let rows = request.history_z.len();
    assert!(rows >= 3);
    // As many numbers as those of three rows of two members, or of two rows of three.
    for (members, error) in [(2, None), (3, Some("history_f")), (6, Some("history_f"))] {
        request.history_f = Predictions::new(members, vec![[0.0; 3]; 6]);
        let answer = engine.step(&mut workspace, &request.encode(), &mut Vec::new());
        let field = answer.err().map(|error| error.field);
        assert_eq!(field.as_deref(), error, "{members} members");
    }
}

#[test]
fn a_plan_is_shifted_by_the_periods_that_the_message_states() {
    // The states of a roll-out depend on the inputs of the plan only, of which the last one is held with constant angle.
    let mut settings = requests::settings();
    settings.operating.kind = Operating::Rollout;
    let warm = requests::warm();
    let library = libraries::library(Kernel::Rbf, &[0.5, 1.1], 250, 3);
    let engine = Engine::new(library, settings).unwrap();
    let mut workspace = engine.workspace().unwrap();
    let mut reply = |request: &requests::Request| {
        let (bytes, mut reply) = (message(request, engine.library().id()), Vec::new());
        let status = engine.step(&mut workspace, &bytes, &mut reply).unwrap();
        assert_eq!(status, Status::Solved);
        reply
    };
    let now = reply(&warm);
    for shift in [1, 3] {
        let mut shifted = warm.clone();
        shifted.plan_u.drain(..2 * shift);
        shifted.plan_u.extend([warm.plan_u[38], 0.0].repeat(shift));
        let late = requests::Request {
            plan_shift: u32::try_from(shift).unwrap(),
            ..warm.clone()
        };
        let late = reply(&late);
        assert!(late == reply(&shifted), "the replies differ, {shift}");
        assert!(late != now, "the replies are the same, {shift}");
    }
}
