//! Covariance of the errors in the window, from which `S` of eq. (6) follows.

use crate::settings::WeightSettings;
use crate::{GpOutput, Library, Member, NY};

/// Candidate fractions of the standard deviations of the members' noise: errors over all training data are larger than errors
/// in a steady bend.
const MODEL: [f64; 2] = [1.0, 0.5];
/// Candidate fractions of the standard deviations of the measured states' noise: sensors may be better than specified.
const STATE: [f64; 3] = [1.0, 0.3, 0.1];
const LEVELS: usize = MODEL.len() * STATE.len();

/// Covariance of one output's errors `e_k = y_k - (F w)_k` over consecutive transitions.
///
/// A measured change is the difference of two measured states. With independent model noise of variance `q` and
/// state noise of variance `r`, `e_k = v_k + n_{k+1} - n_k`, so that
///
/// ```text
/// cov(e_k, e_k) = q + 2 r,    cov(e_k, e_{k+1}) = -r
/// ```
///
/// and generalised least squares applies (Aitken, *On Least Squares and Linear Combination of Observations*, Proceedings of
/// the Royal Society of Edinburgh 55, 1935). The noise of a state enters consecutive changes with opposite signs and cancels
/// in their sum, so that a persistent difference between members competes with the noise of the window's two end states only.
/// With noise of 0.03 m/s, changes of 0.01 m/s are not visible in one transition but are in a window of 25.
///
/// `q` and `r` may have several candidate levels. Each window uses the level, for all outputs, with the largest
/// Gaussian likelihood of the errors under the previous weights (multiple-model estimation; Magill, *Optimal Adaptive
/// Estimation of Sampled Stochastic Processes*, IEEE Transactions on Automatic Control 10(4), 1965).
#[derive(Debug, Clone)]
pub struct WindowNoise {
    levels: usize,
    /// A row for each level of each transition, level by level within a transition.
    rows: Vec<Row>,
}

/// One transition's row of `L` for each output: bidiagonal, with `L Lᵀ` the covariance of consecutive errors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    /// Reciprocal diagonal.
    inverse: GpOutput,
    /// Entry left of the diagonal; zero for the first transition.
    below: GpOutput,
    /// Logarithm of the covariance's determinant up to this transition, over all outputs.
    log_det: f64,
}

impl Row {
    /// Whitened error of one output, from the error and the whitened error of the previous transition.
    pub fn whiten(&self, output: usize, error: f64, before: f64) -> f64 {
        (error - self.below[output] * before) * self.inverse[output]
    }
}

impl WindowNoise {
    /// A single level for windows of at most `window` transitions, from standard deviations of the model's one-step
    /// predictions (positive) and of the measured `[v_x, v_y, omega]` (at least zero).
    pub fn new(model_std: &GpOutput, state_std: &GpOutput, window: usize) -> Self {
        Self::with_levels(&[[*model_std, *state_std]], window)
    }

    /// Levels from the members' root-mean-square noise, the setting `measurement`, and fractions of both. Without
    /// `whiten` this is the paper's `S = I`.
    pub fn of(library: &Library, settings: &WeightSettings) -> Self {
        let window = settings.window(library);
        if !settings.whiten {
            return Self::new(&GpOutput::repeat(1.0), &GpOutput::zeros(), window);
        }
        let (model, state) = (model_std(library), state_std(library, settings));
        let levels = STATE.map(|r| MODEL.map(|q| [model * q, state * r]));
        Self::with_levels(levels.as_flattened(), window)
    }

    /// At most [`LEVELS`] levels, given as standard deviations of model and states.
    fn with_levels(levels: &[[GpOutput; 2]], window: usize) -> Self {
        let variances = levels
            .iter()
            .map(|std| std.map(|std| std.component_mul(&std)));
        let mut next: Vec<([GpOutput; 2], Row)> = variances
            .map(|variances| {
                let none = Row {
                    inverse: GpOutput::zeros(),
                    below: GpOutput::zeros(),
                    log_det: 0.0,
                };
                (variances, none)
            })
            .collect();
        let mut rows = Vec::with_capacity(levels.len() * window);
        for _ in 0..window {
            for ([model, state], row) in &mut next {
                row.below = -state.component_mul(&row.inverse);
                let diagonal =
                    (*model + *state * 2.0 - row.below.component_mul(&row.below)).map(f64::sqrt);
                row.inverse = diagonal.map(f64::recip);
                row.log_det += 2.0 * diagonal.map(f64::ln).sum();
                rows.push(*row);
            }
        }
        Self {
            levels: levels.len(),
            rows,
        }
    }

    /// The whitening of consecutive transitions, at the level with the largest likelihood of the errors under the
    /// weights `previous`: rows `[N * 3]` of predictions, and the measured changes.
    pub(crate) fn rows(
        &self,
        predictions: &[f64],
        measured: &[[f64; NY]],
        previous: &[f64],
    ) -> impl Iterator<Item = &Row> {
        let transitions = predictions.chunks_exact(previous.len() * NY).zip(measured);
        self.likeliest(transitions.map(|(row, y)| blend_error(row, y, previous)))
    }

    /// Rows of the level with the largest likelihood of `errors`, one error for each of consecutive transitions. Rows
    /// of the first level if there are no errors or if no likelihood is finite.
    fn likeliest(&self, errors: impl Iterator<Item = GpOutput>) -> impl Iterator<Item = &Row> {
        let mut white = [GpOutput::zeros(); LEVELS];
        let mut squares = [0.0; LEVELS];
        let mut last: &[Row] = &[];
        if self.levels > 1 {
            for (rows, error) in self.rows.chunks_exact(self.levels).zip(errors) {
                for ((row, white), square) in rows.iter().zip(&mut white).zip(&mut squares) {
                    *white = GpOutput::from_fn(|o, _| row.whiten(o, error[o], white[o]));
                    *square += white.norm_squared();
                }
                last = rows;
            }
        }
        let misfits = last
            .iter()
            .zip(squares)
            .map(|(row, square)| square + row.log_det);
        let likeliest = misfits
            .enumerate()
            .fold((0, f64::INFINITY), |best, next| {
                if next.1 < best.1 { next } else { best }
            })
            .0;
        self.rows.iter().skip(likeliest).step_by(self.levels)
    }
}

/// Root mean square of the members' noise.
pub(crate) fn model_std(library: &Library) -> GpOutput {
    let members = library.members();
    let squares = |member: &Member| member.noise_std().map(|std| std * std);
    let variance: GpOutput = members.iter().map(squares).sum();
    (variance / members.len() as f64).map(f64::sqrt)
}

/// Noise of the measured states.
pub(crate) fn state_std(library: &Library, settings: &WeightSettings) -> GpOutput {
    GpOutput::from(settings.measurement(library.metadata().measurement_noise))
}

/// Error `y - F w` of the blended prediction of a transition, from its row `[N * 3]` of predictions.
pub(crate) fn blend_error(predicted: &[f64], measured: &[f64; NY], weights: &[f64]) -> GpOutput {
    let predicted = predicted.as_chunks::<NY>().0.iter().zip(weights);
    predicted.fold(GpOutput::from(*measured), |error, (f, w)| {
        error - GpOutput::from(*f) * *w
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Errors with the given noise of model and states, made from waves without a common period.
    fn errors(model: f64, state: f64, n: usize) -> Vec<GpOutput> {
        let wave = |k: usize, o: usize| {
            let k = (7 * k + 3 * o) as f64;
            2.0_f64.sqrt() * (k * k * 0.37).sin()
        };
        (0..n)
            .map(|k| {
                GpOutput::from_fn(|o, _| {
                    let states = wave(k + 1, o + 5) - wave(k, o + 5);
                    model * wave(k, o) + state * states
                })
            })
            .collect()
    }

    /// The first row of the chosen level, which identifies the level.
    fn chosen(noise: &WindowNoise, errors: Vec<GpOutput>) -> GpOutput {
        let mut rows = noise.likeliest(errors.into_iter());
        rows.next().map_or(GpOutput::zeros(), |row| row.inverse)
    }

    #[test]
    fn the_likeliest_level_is_the_one_that_generated_the_errors() {
        let levels = [[1.0, 3.0], [0.3, 3.0], [1.0, 0.3], [0.3, 0.3]]
            .map(|level| level.map(GpOutput::repeat));
        let noise = WindowNoise::with_levels(&levels, 200);
        for (i, [model, state]) in levels.iter().enumerate() {
            let errors = errors(model[0], state[0], 200);
            assert_eq!(chosen(&noise, errors), noise.rows[i].inverse, "level {i}");
        }
    }

    #[test]
    fn without_finite_likelihood_the_first_level_is_used() {
        let noise = WindowNoise::with_levels(&[1.0, 0.5].map(|std| [GpOutput::repeat(std); 2]), 2);
        for errors in [vec![], vec![GpOutput::repeat(f64::MAX); 2]] {
            assert_eq!(chosen(&noise, errors), noise.rows[0].inverse);
        }
    }
}
