//! Paths made of their parts, as a stored path is.
#![allow(clippy::unwrap_used)]

use egp_parameters::{OutOfRange, Surface};
use egp_path::tracks::RoundedRectangle;
use egp_path::{
    HorizonRows, Path, PathError, PathParts, ReferenceStart, SpeedProfile, Zone, horizon_reference,
};

use crate::path::{circle, wave};

#[test]
fn a_path_made_of_the_parts_of_another_one_has_the_same_bits() {
    let zones = [Zone::new(0.0, 0.7), Zone::new(0.4, Surface::ICE)];
    let closed = RoundedRectangle::default().path().unwrap();
    let closed = closed.with_friction(&zones).unwrap();
    for path in [closed, wave(), circle(30.0, 40)] {
        let again = Path::from_parts(path.parts()).unwrap();
        assert_eq!(again.parts(), path.parts());
        for k in -3..40 {
            let s = 0.1 * f64::from(k) * path.length();
            assert_eq!(again.sample(s), path.sample(s));
            let at = [f64::from(k), 2.0];
            assert_eq!(again.project(at, None), path.project(at, None));
        }
        let profile = SpeedProfile::constant(&path, 10.0).unwrap();
        let start = ReferenceStart {
            position: [0.0; 2],
            psi: 0.0,
            catch_up_from: None,
            hint: None,
        };
        horizon_reference(&again, &profile, &start, 0.05, &mut HorizonRows::new(3)).unwrap();
    }
}

#[test]
fn a_path_with_long_pieces_has_the_same_bits_too() {
    let points: Vec<[f64; 2]> = (0..2001).map(|i| [100.0 * f64::from(i), 0.0]).collect();
    let path = Path::from_points(&points, false, None).unwrap();
    assert!(path.parts().step > 1.0);
    let again = Path::from_parts(path.parts()).unwrap();
    assert_eq!(again.parts(), path.parts());
}

#[test]
fn parts_of_which_no_path_consists_are_an_error() {
    let parts = RoundedRectangle::default().path().unwrap().parts();
    let error = |change: fn(&mut PathParts)| {
        let mut parts = parts.clone();
        change(&mut parts);
        Path::from_parts(parts).unwrap_err()
    };
    let named = |error: PathError| match error {
        PathError::Parameter(OutOfRange { name, .. }) => name,
        PathError::NotFinite { what, .. } => what,
        _ => "",
    };
    assert_eq!(named(error(|parts| parts.step = 0.0)), "step");
    assert_eq!(named(error(|parts| parts.step = f64::NAN)), "step");
    let none = error(|parts| parts.pieces.clear());
    assert_eq!(named(none), "the number of pieces");
    // A planner of the speed has 200 m of knots, one at the end of each piece.
    for step in [1e-9, 1e12] {
        let parts = PathParts {
            step,
            ..parts.clone()
        };
        assert_eq!(named(Path::from_parts(parts).unwrap_err()), "step");
    }
    let nan = error(|parts| parts.pieces[3][1][2] = f64::NAN);
    assert_eq!(named(nan), "coefficients");
    assert!(matches!(
        error(|parts| parts.closed = false),
        PathError::WidthCount { .. }
    ));
    let negative = error(|parts| parts.widths = Some(vec![[-1.0; 2]; parts.pieces.len()]));
    assert_eq!(named(negative), "widths of at least 0");
    assert!(matches!(
        error(|parts| parts.zones = vec![Zone::new(0.5, 1.0)]),
        PathError::ZoneStart { .. }
    ));
}
