//! Noise of the window's errors, which decides how much each says: `S` of eq. (6), and what neighbours share.

use crate::settings::WeightSettings;
use crate::{GpOutput, Library, NY};

/// Covariance of one output's errors `e_k = y_k - (F w)_k` over consecutive transitions.
///
/// A measured change is the difference of two measured states. With independent model noise of variance `q` and
/// state noise of variance `r`, `e_k = v_k + n_{k+1} - n_k`, so that
///
/// ```text
/// cov(e_k, e_k) = q + 2 r,    cov(e_k, e_{k+1}) = -r
/// ```
///
/// and generalised least squares applies (Aitken 1935). What one state's noise adds to one change, it takes from the
/// next: over a window, a lasting difference between members is seen against the noise of its two ends, not of all
/// its states. Measured states with noise of 0.03 m/s hide single changes of 0.01 m/s; a window of 25 shows them.
#[derive(Debug, Clone, Copy)]
pub struct WindowNoise {
    model: GpOutput,
    state: GpOutput,
}

impl WindowNoise {
    /// From standard deviations of the model's one-step predictions, positive, and of the measured
    /// `[v_x, v_y, omega]`, at least zero.
    pub fn new(model_std: &GpOutput, state_std: &GpOutput) -> Self {
        Self {
            model: model_std.component_mul(model_std),
            state: state_std.component_mul(state_std),
        }
    }

    /// Of the members' root-mean-square noise and the setting `measurement`; with `whiten` off the paper's `S = I`.
    pub fn of(library: &Library, settings: &WeightSettings) -> Self {
        if !settings.whiten {
            return Self::new(&GpOutput::repeat(1.0), &GpOutput::zeros());
        }
        let members = library.members();
        let variance: GpOutput = members
            .iter()
            .map(|m| m.noise_std().map(|std| std * std))
            .sum();
        Self::new(
            &(variance / members.len() as f64).map(f64::sqrt),
            &settings.measurement.into(),
        )
    }

    /// Rows of `L` in `L Lᵀ = covariance`, which has a diagonal and one below it: `[diagonal, below]` for each
    /// output.
    pub(super) fn cholesky_rows(self) -> impl Iterator<Item = [[f64; 2]; NY]> {
        let mut row = [[f64::INFINITY, 0.0]; NY];
        std::iter::repeat_with(move || {
            for (output, [diagonal, below]) in row.iter_mut().enumerate() {
                let (q, r) = (self.model[output], self.state[output]);
                *below = -r / *diagonal; // none before the first
                *diagonal = (q + 2.0 * r - *below * *below).sqrt();
            }
            row
        })
    }
}
