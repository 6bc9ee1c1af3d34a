//! Innovations of models of the vehicle over a window of measured states.

use nalgebra::SMatrix;

use crate::settings::WeightSettings;
use crate::weights::{model_std, state_std};
use crate::{GpOutput, Library, NY};

/// A matrix of `[v_x, v_y, omega]`.
pub(super) type Square = SMatrix<f64, NY, NY>;

/// Covariance of the innovations over consecutive transitions, oldest first.
///
/// The measured state is `x + n` with noise `n` of variance `R`, and the change of the state is `f(x) + v` with the model's
/// error `v` of variance `Q`. The noise of a measured state thus is in the measured change and, if the prediction is made at
/// the measured state, in the prediction, too: at 10 m/s the tyre forces of a passenger car reduce a lateral speed by 40 %
/// within 20 ms. The fitted vehicles are therefore evaluated at an estimated state; what the Gaussian processes add is taken
/// at the measured one, and `F` leaves it out. With the deviation `d` of the state that a model estimates from the measured
/// one, the deviation `d_0` of the state at which all vehicles are evaluated, the error `e` of the prediction there, and its
/// Jacobian `F`, one step of the extended Kalman filter (Anderson and Moore, *Optimal Filtering*, 1979, section 8.2) has the
/// innovation
///
/// ```text
/// nu = e - d - F (d - d_0),    S = (I + F) P (I + F)ᵀ + Q + R,    K = (S - R) S⁻¹
/// d <- (K - I) nu,             P <- (I - K) (S - R)
/// ```
///
/// Each model has its own `F` in `nu`, and all have the covariances of their mean `F`: with covariances of their own, a model
/// that damps noise faster would be the likelier one wherever sensors are better than stated.
#[derive(Debug, Clone)]
pub(super) struct Innovations {
    /// `Q`.
    model: Square,
    /// `R`.
    state: Square,
    /// `P`.
    covariance: Square,
}

/// The matrices of one step of the filter, which all models share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gain {
    /// `S`.
    pub covariance: Square,
    /// `S⁻¹`.
    information: Square,
    /// `K - I`.
    correction: Square,
}

impl Innovations {
    /// With the members' root-mean-square noise and that of the measured states in `settings`.
    pub fn new(library: &Library, settings: &WeightSettings) -> Self {
        let variance = |std: GpOutput| Square::from_diagonal(&std.component_mul(&std));
        let state = variance(state_std(library, settings));
        Self {
            model: variance(model_std(library)),
            state,
            covariance: state,
        }
    }

    /// Starts a window.
    pub fn restart(&mut self) {
        self.covariance = self.state;
    }

    /// The gain of the next transition with the models' mean Jacobian; `None` if the covariance is not positive definite,
    /// which happens with numbers that are not finite, or whose magnitudes differ by more than the precision of `f64`.
    pub fn next(&mut self, jacobian: &Square) -> Option<Gain> {
        let transition = Square::identity() + jacobian;
        let prior = transition * self.covariance * transition.transpose() + self.model;
        let of_innovation = prior + self.state;
        let information = of_innovation.cholesky()?.inverse();
        let correction = prior * information - Square::identity();
        let covariance = -correction * prior;
        self.covariance = (covariance + covariance.transpose()) * 0.5;
        Some(Gain {
            covariance: of_innovation,
            information,
            correction,
        })
    }
}

impl Gain {
    /// Updates the deviation of the state that a model estimates, from the error of its prediction at the deviation `common` from
    /// the measured state and its Jacobian there, and returns the square of the whitened innovation. The
    /// innovation is added to `sum`.
    pub fn advance(
        &self,
        error: &GpOutput,
        jacobian: &Square,
        common: &GpOutput,
        deviation: &mut GpOutput,
        sum: &mut GpOutput,
    ) -> f64 {
        let innovation = error - *deviation - jacobian * (*deviation - common);
        *deviation = self.correction * innovation;
        *sum += innovation;
        innovation.dot(&(self.information * innovation))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use nalgebra::{DMatrix, DVector};

    use super::*;

    const TRANSITIONS: usize = 12;

    fn wave(k: usize, seed: usize) -> f64 {
        let k = (7 * k + 3 * seed + 1) as f64;
        (k * k * 0.37).sin()
    }

    fn variances(seed: usize) -> Square {
        Square::from_diagonal(&GpOutput::from_fn(|o, _| 1.5 + wave(o, seed)))
    }

    #[test]
    fn squares_are_those_of_generalised_least_squares() {
        // The errors e_k = n_{k+1} - (I + F_k) n_k + v_k of all transitions have one covariance C, and the sum is eᵀ C⁻¹ e.
        let [model, state] = [1, 2].map(variances);
        let jacobians: Vec<_> = (0..TRANSITIONS)
            .map(|k| Square::from_fn(|i, j| 0.4 * wave(k, 3 * i + j)))
            .collect();
        let errors: Vec<_> = (0..TRANSITIONS)
            .map(|k| GpOutput::from_fn(|o, _| wave(k, 20 + o)))
            .collect();
        let mut innovations = Innovations {
            model,
            state,
            covariance: state,
        };
        let mut deviation = GpOutput::zeros();
        let mut sum = 0.0;
        for (error, jacobian) in errors.iter().zip(&jacobians) {
            let gain = innovations.next(jacobian).unwrap();
            // The place at which a linear model is evaluated makes no difference.
            let common = error * 0.3;
            sum += gain.advance(
                &(error - jacobian * common),
                jacobian,
                &common,
                &mut deviation,
                &mut GpOutput::zeros(),
            );
        }

        let size = TRANSITIONS * NY;
        let mut covariance = DMatrix::zeros(size, size);
        for (k, jacobian) in jacobians.iter().enumerate() {
            let transition = Square::identity() + jacobian;
            let own = state + transition * state * transition.transpose() + model;
            covariance
                .fixed_view_mut::<NY, NY>(NY * k, NY * k)
                .copy_from(&own);
            if k > 0 {
                let both = -transition * state;
                covariance
                    .fixed_view_mut::<NY, NY>(NY * k, NY * (k - 1))
                    .copy_from(&both);
                covariance
                    .fixed_view_mut::<NY, NY>(NY * (k - 1), NY * k)
                    .copy_from(&both.transpose());
            }
        }
        let stacked = DVector::from_iterator(size, errors.iter().flatten().copied());
        let expected = stacked.dot(&covariance.cholesky().unwrap().solve(&stacked));
        assert!((sum / expected - 1.0).abs() < 1e-12, "{sum} {expected}");
    }

    #[test]
    fn numbers_that_are_not_finite_have_no_gain() {
        let [model, state] = [1, 2].map(variances);
        let mut innovations = Innovations {
            model,
            state,
            covariance: state,
        };
        assert!(innovations.next(&Square::repeat(f64::NAN)).is_none());
        innovations.restart();
        assert!(innovations.next(&Square::repeat(f64::INFINITY)).is_none());
    }
}
