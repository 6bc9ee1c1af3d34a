//! What the predictions of several single-track vehicles of one body share.

use super::single_track::SLOWEST;
use crate::GpInput;

/// Steering angle and directions of motion at the axles for one input, in the body of a vehicle: where its axles are, and
/// for which period it predicts. They contain most of the trigonometry of a prediction, and do not depend on the tyres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Attitude {
    dt: f64,
    positions: [f64; 2],
    /// Steering angle in the middle of the period, rad.
    pub steering: f64,
    /// Sine and cosine of the steering angle.
    pub turned: (f64, f64),
    /// `atan((v_y + l omega) / v_x)` of the front and the rear axle, rad.
    pub directions: [f64; 2],
}

impl Attitude {
    /// The attitude at `z`, with axles at `positions` ahead of the centre of mass, m, over a period of `dt` s.
    pub fn new(z: &GpInput, dt: f64, positions: [f64; 2]) -> Self {
        let steering = z[3] + 0.5 * dt * z[5];
        let v = z[0].max(SLOWEST);
        Self {
            dt,
            positions,
            steering,
            turned: steering.sin_cos(),
            directions: positions.map(|position| ((z[1] + position * z[2]) / v).atan()),
        }
    }

    /// Whether this is the attitude of a vehicle with these axles over this period.
    pub fn is_of(&self, dt: f64, positions: [f64; 2]) -> bool {
        self.dt == dt && self.positions == positions
    }
}
