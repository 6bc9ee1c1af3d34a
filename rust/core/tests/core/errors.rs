//! Errors of a step for invalid requests, and of settings.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::semicolon_if_nothing_returned
)]

use egp_core::{Settings, StepError, StepReply, Workspace, step};
use egp_testing::requests::{Request, library, settings, warm};

#[test]
fn errors_of_malformed_requests_name_the_field() {
    let settings = settings();
    let mut ws = Workspace::new(library(), &settings).unwrap();
    let mut reply = StepReply::default();
    let mut reject = |change: fn(&mut Request)| {
        let mut request = warm();
        change(&mut request);
        let error = step(library(), &settings, &request.borrow(), &mut ws, &mut reply).unwrap_err();
        assert!(reply.plan_u.is_empty() && reply.weights.is_empty());
        error
    };
    let shape = |error: StepError| match error {
        StepError::Shape { field, .. }
        | StepError::Window { field, .. }
        | StepError::NotFinite { field, .. } => field,
        other => panic!("{other}"),
    };
    assert_eq!(shape(reject(|r| r.reference.truncate(80))), "reference");
    assert_eq!(shape(reject(|r| r.widths.truncate(3))), "widths");
    assert_eq!(shape(reject(|r| r.weights.push(0.0))), "weights");
    assert_eq!(
        shape(reject(|r| r.road_friction = vec![0.5; 42])),
        "road_friction"
    );
    assert_eq!(shape(reject(|r| r.plan_u.clear())), "plan_u");
    assert_eq!(shape(reject(|r| r.plan_x.clear())), "plan_u");
    assert_eq!(shape(reject(|r| r.plan_x.truncate(7))), "plan_x");
    assert_eq!(shape(reject(|r| r.history_z.truncate(5))), "history_z");
    assert_eq!(shape(reject(|r| r.history_y.truncate(27))), "history_y");
    assert_eq!(shape(reject(|r| r.history_f.truncate(5))), "history_f");
    assert_eq!(shape(reject(|r| r.history_z.extend([0.0; 6]))), "history_z");
    assert_eq!(shape(reject(|r| r.reference[7] = f64::NAN)), "reference");
    assert_eq!(shape(reject(|r| r.plan_u[3] = f64::INFINITY)), "plan_u");
    assert_eq!(shape(reject(|r| r.history_f[3] = 1e300)), "history_f");
    let domain = |error: StepError| match error {
        StepError::Domain { field, .. } => field,
        other => panic!("{other}"),
    };
    assert_eq!(domain(reject(|r| r.x[2] = 200.0)), "x");
    assert_eq!(domain(reject(|r| r.u_prev[0] = 1e6)), "u_prev");
    assert_eq!(domain(reject(|r| r.reference[0] = 2000.0)), "reference");
    assert_eq!(domain(reject(|r| r.reference[2] = -1.1)), "reference");
    assert_eq!(domain(reject(|r| r.widths[3] = 2000.0)), "widths");
    for (friction, std) in [(0.0, 0.1), (3.1, 0.1), (0.5, -0.1), (0.5, 3.1)] {
        let mut request = warm();
        request.road_friction = [friction, std].repeat(22);
        let error = step(library(), &settings, &request.borrow(), &mut ws, &mut reply).unwrap_err();
        assert!(
            matches!(error, StepError::Domain { .. }),
            "{friction} {std}"
        );
    }
    let mut reject = |change: fn(&mut Request)| {
        let mut request = warm();
        change(&mut request);
        step(library(), &settings, &request.borrow(), &mut ws, &mut reply).unwrap_err()
    };
    assert!(matches!(
        reject(|r| r.weights = vec![0.5, 0.6]),
        StepError::Weights { .. }
    ));
    assert!(matches!(
        reject(|r| r.weights = vec![-0.1, 1.1]),
        StepError::Weights { .. }
    ));
    let other = Settings {
        horizon: Some(10),
        ..Settings::default()
    };
    let error = step(library(), &other, &warm().borrow(), &mut ws, &mut reply).unwrap_err();
    assert_eq!(error, StepError::Workspace);
}

#[test]
fn a_value_in_place_of_a_table_is_called_so() {
    for (name, expected) in [
        ("weights", "a table"),
        ("weights.prior", "a table with `kind`"),
        ("residual", "a table"),
        ("operating", "a table"),
        ("cost", "a table"),
        ("limits", "a table"),
        ("soft", "a table"),
        ("soft.track", "a table"),
        ("solver", "a table"),
    ] {
        let error = Settings::from_toml(&format!("{name} = 3")).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(&format!("expected {expected}")), "{text}");
        for rust in ["struct", "enum", "Settings", "Cost", "Soft", "Prior"] {
            assert!(!text.contains(rust), "{text}");
        }
    }
}

#[test]
fn a_quadratic_prior_without_strength_has_the_default() {
    let text = "[weights.prior]\nkind = \"quadratic\"";
    assert_eq!(Settings::from_toml(text).unwrap(), Settings::default());
    for text in [
        "[weights.prior]\nkind = \"l1\"",
        "[weights.prior]\nlambda = 3.0",
    ] {
        assert!(Settings::from_toml(text).is_err(), "{text}");
    }
}
