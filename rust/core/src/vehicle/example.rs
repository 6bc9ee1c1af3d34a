//! A single-track vehicle and inputs for the tests of this module.

use super::{SINGLE_TRACK_PARAMETERS, SingleTrack};
use crate::{GpInput, NZ};

/// Parameters of a mid-size car.
pub(super) const CAR: [f64; SINGLE_TRACK_PARAMETERS] = [
    1225.0, 0.87, 1.52, 1.6, 0.45, 0.5, 0.8, 1.9, 1.2, 0.9, 15.0, 1.6, 0.3, 1.1, 1.1, 20.0, 1.2,
];

/// Parameters of a model car of a tenth of the size, whose slip angles are computed from 1.2 m/s on.
pub(super) const MODEL_CAR: [f64; SINGLE_TRACK_PARAMETERS] = [
    3.74, 0.159, 0.171, 0.0126, 0.06, 0.5, 0.8, 1.9, 1.2, 0.9, 15.0, 1.6, 0.3, 1.1, 1.1, 20.0, 1.2,
];

/// Inputs with drive and braking, one of them below the lowest speed of slip angles, and one of a slide.
pub(super) fn inputs() -> [GpInput; 4] {
    [
        GpInput::new(15.0, 0.3, 0.4, 0.05, 2000.0, 0.1),
        GpInput::new(22.0, -1.0, 0.2, -0.1, -9000.0, -0.3),
        GpInput::new(2.0, 0.1, 0.3, 0.3, 500.0, 0.4),
        GpInput::new(9.0, 3.0, -1.5, 0.4, 7000.0, 0.0),
    ]
}

/// Compares the Jacobian of a vehicle with finite differences at all inputs.
pub(super) fn check_jacobian(car: &SingleTrack, tolerance: f64) {
    let steps = [1e-5, 1e-5, 1e-6, 1e-6, 1e-1, 1e-5];
    for z in inputs() {
        let (value, jacobian) = car.change_jacobian(&z);
        assert_eq!(value, car.change(&z));
        for d in 0..NZ {
            let mut shift = GpInput::zeros();
            shift[d] = steps[d];
            let slope = (car.change(&(z + shift)) - car.change(&(z - shift))) / (2.0 * steps[d]);
            for o in 0..slope.len() {
                let error = (slope[o] - jacobian[(o, d)]).abs() * z[d].abs().max(1.0);
                assert!(
                    error < tolerance,
                    "{o} {d}: {} {}",
                    slope[o],
                    jacobian[(o, d)]
                );
            }
        }
    }
}
