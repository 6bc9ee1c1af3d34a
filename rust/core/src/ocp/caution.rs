//! Constraints tightened by the uncertainty of the plan.

use nalgebra::SMatrix;

use super::bounds::NARROWEST;
use crate::qp::{OcpQp, SOFT_SPEED, SOFT_TRACK, Stage};
use crate::vehicle::VELOCITIES;
use crate::{GpOutput, NU, NX, State};

/// What is uncertain about one transition.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct TransitionUncertainty {
    /// Variances of the change of `[v_x, v_y, omega]` in (m/s)², (m/s)², (rad/s)², independent between stages.
    pub variance: GpOutput,
    /// Change of `[v_x, v_y, omega]` in m/s, m/s, rad/s by one standard deviation of the friction, which is the same at all
    /// stages.
    pub friction: GpOutput,
}

/// Propagates the uncertainty along a plan, with its memory.
///
/// The deviation `e` of the vehicle from the plan is reduced by later control steps, which act like the regulator of the
/// same cost:
///
/// ```text
/// e_{t+1} = (A_t + B_t K_t) e_t + d_t + g_t xi,      K_t = -(R + R_d + BᵀPB)⁻¹ BᵀPA
/// ```
///
/// `d_t` are independent with the variances of the ensemble, and `xi ~ N(0, 1)` is the error of the friction, one for
/// the whole horizon. The row `nᵀx <= b` of a constraint becomes
///
/// ```text
/// nᵀx_t <= b - k_sigma sqrt(nᵀ Sigma_t n + (nᵀ s_t)²),     Sigma_t = cov e_t for xi = 0,   s_t = ∂e_t/∂xi
/// ```
///
/// Hewing, Kabzan and Zeilinger, *Cautious Model Predictive Control using Gaussian Process Regression*, IEEE Transactions
/// on Control Systems Technology 28(6), 2020, section III, with the gains of the regulator in place of a constant one.
#[derive(Debug, Clone)]
pub struct Caution {
    gains: Vec<SMatrix<f64, NU, NX>>,
}

impl Caution {
    /// For a horizon of `horizon` periods.
    pub fn new(horizon: usize) -> Self {
        Self {
            gains: vec![SMatrix::zeros(); horizon],
        }
    }

    /// Tightens the track's edges and the bound on the speed in `qp` by `k_sigma` standard deviations. Where the edges leave
    /// no room they become the narrowest strip about their middle. `uncertainties` has one entry for each transition.
    pub fn tighten(
        &mut self,
        k_sigma: f64,
        uncertainties: &[TransitionUncertainty],
        qp: &mut OcpQp,
    ) {
        self.regulate(qp);
        let mut covariance = SMatrix::<f64, NX, NX>::zeros();
        let mut common = State::zeros();
        let stages = qp.stages_mut().iter_mut().zip(uncertainties);
        for ((stage, uncertainty), gain) in stages.zip(&self.gains) {
            let closed = stage.a + stage.b * gain;
            covariance = closed * covariance * closed.transpose();
            common = closed * common;
            for (o, state) in VELOCITIES.into_iter().enumerate() {
                covariance[(state, state)] += uncertainty.variance[o];
                common[state] += uncertainty.friction[o];
            }
            let std = |normal: &State| {
                let variance = normal.dot(&(covariance * normal)).max(0.0);
                k_sigma * (variance + normal.dot(&common).powi(2)).sqrt()
            };
            narrow(stage, std);
        }
    }

    /// Computes the regulator's gains backward along the horizon.
    fn regulate(&mut self, qp: &OcpQp) {
        let weight = SMatrix::<f64, NU, NU>::from_diagonal(&(qp.r + qp.r_d));
        let mut cost = SMatrix::<f64, NX, NX>::zeros();
        for (stage, gain) in qp.stages().iter().zip(&mut self.gains).rev() {
            cost += stage.q;
            let (by_b, by_a) = (cost * stage.b, cost * stage.a);
            let inverse = inverse(&(weight + stage.b.transpose() * by_b));
            *gain = -inverse * stage.b.transpose() * by_a;
            cost = stage.a.transpose() * (by_a + by_b * *gain);
            cost = (cost + cost.transpose()) * 0.5;
        }
    }
}

/// Determinant relative to the product of the diagonal below which rounding may have changed it by more than about 1 %.
const LEAST_DETERMINANT: f64 = 1e-12;

/// Part of the trace that is added to the diagonal of a matrix with a smaller determinant.
const RAISE: f64 = 1e-9;

/// The inverse of a symmetric positive definite matrix. A determinant that rounding has changed could have any value, also
/// a negative one. The diagonal is then raised, which hardly changes the inverse in the direction of the largest eigenvalue,
/// and makes it smaller in the other one.
fn inverse(m: &SMatrix<f64, NU, NU>) -> SMatrix<f64, NU, NU> {
    let determinant = |m: &SMatrix<f64, NU, NU>| m[(0, 0)] * m[(1, 1)] - m[(0, 1)] * m[(1, 0)];
    let mut m = *m;
    if determinant(&m) < LEAST_DETERMINANT * m[(0, 0)] * m[(1, 1)] {
        let raise = RAISE * m.trace();
        (0..NU).for_each(|i| m[(i, i)] += raise);
    }
    SMatrix::from_row_slice(&[m[(1, 1)], -m[(0, 1)], -m[(1, 0)], m[(0, 0)]]) / determinant(&m)
}

/// Moves the bounds of one stage inwards. A bound whose standard deviation is not finite stays where it is.
fn narrow(stage: &mut Stage, std: impl Fn(&State) -> f64) {
    let speed = &mut stage.soft[SOFT_SPEED];
    let margin = std(&speed.normal);
    if margin.is_finite() {
        speed.upper = (speed.upper - margin).max(speed.lower);
    }
    let track = &mut stage.soft[SOFT_TRACK];
    let (margin, middle) = (std(&track.normal), f64::midpoint(track.lower, track.upper));
    if margin.is_finite() {
        let (lower, upper) = (track.lower + margin, track.upper - margin);
        track.lower = lower.min(middle - NARROWEST).max(track.lower);
        track.upper = upper.max(middle + NARROWEST).min(track.upper);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Input;

    #[test]
    fn a_matrix_that_rounding_makes_singular_is_inverted_in_the_direction_of_its_large_eigenvalue()
    {
        for i in 1..1000 {
            let (sin, cos) = (0.003 * f64::from(i)).sin_cos();
            let direction = Input::new(cos, sin);
            let m =
                direction * direction.transpose() * 2e9 + SMatrix::<f64, NU, NU>::identity() * 1e-9;
            let inverse = inverse(&m);
            let error = (inverse * direction * 2e9 - direction).norm();
            assert!(error < 1e-6, "{i}: {error}");
            let across = Input::new(-sin, cos);
            let other = across.dot(&(inverse * across));
            assert!(other > 0.0 && other < 1e9, "{i}: {other}");
        }
    }

    #[test]
    fn bounds_stay_where_they_are_if_the_deviation_is_not_finite() {
        let mut qp = OcpQp::new(1, 3);
        let before = qp.clone();
        for std in [f64::NAN, f64::INFINITY] {
            narrow(&mut qp.stages_mut()[0], |_| std);
            assert_eq!(qp.stages(), before.stages());
        }
        narrow(&mut qp.stages_mut()[0], |_| 0.1);
        assert_ne!(qp.stages(), before.stages());
    }
}
