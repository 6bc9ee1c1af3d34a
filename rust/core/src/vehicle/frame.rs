//! The frame of the measured pose, in which the whole step is computed.
//!
//! There the vehicle stands at the origin and looks along +x, so that plans are the same wherever on earth and in
//! whichever direction the vehicle drives, however often its yaw has wound around, and no digits are lost to
//! map coordinates of 10^6 m.

use std::f64::consts::TAU;

use super::{P_X, P_Y, PSI};
use crate::State;

/// The angle in (-pi, pi] that differs from `angle` (rad) by whole turns.
pub fn wrap(angle: f64) -> f64 {
    let wrapped = angle - TAU * (angle / TAU).round();
    if wrapped <= -std::f64::consts::PI {
        wrapped + TAU
    } else {
        wrapped
    }
}

/// A pose: origin in m, yaw in rad.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    p_x: f64,
    p_y: f64,
    psi: f64,
    sin: f64,
    cos: f64,
}

impl Frame {
    /// The frame of the vehicle in state `x`.
    pub fn of(x: &State) -> Self {
        let (sin, cos) = x[PSI].sin_cos();
        Self {
            p_x: x[P_X],
            p_y: x[P_Y],
            psi: x[PSI],
            sin,
            cos,
        }
    }

    /// A map position in this frame.
    pub fn position_to_local(&self, p_x: f64, p_y: f64) -> [f64; 2] {
        let (dx, dy) = (p_x - self.p_x, p_y - self.p_y);
        [self.cos * dx + self.sin * dy, self.cos * dy - self.sin * dx]
    }

    /// A map yaw relative to this frame's, in (-pi, pi].
    pub fn yaw_to_local(&self, psi: f64) -> f64 {
        wrap(psi - self.psi)
    }

    /// A state of this frame on the map; its yaw continues the measured one.
    pub fn to_map(self, local: &State) -> State {
        let mut x = *local;
        x[P_X] = self.p_x + (self.cos * local[P_X] - self.sin * local[P_Y]);
        x[P_Y] = self.p_y + (self.sin * local[P_X] + self.cos * local[P_Y]);
        x[PSI] += self.psi;
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn wrap_keeps_the_half_open_interval() {
        for (angle, expected) in [
            (0.0, 0.0),
            (PI, PI),
            (-PI, PI),
            (3.0 * PI, PI),
            (TAU + 0.5, 0.5),
            (-7.0, TAU - 7.0),
        ] {
            assert!((wrap(angle) - expected).abs() < 1e-14, "{angle}");
        }
    }

    #[test]
    fn there_and_back() {
        let x = State::from_column_slice(&[5e5, -4e6, 10.0, 7.0, 0.1, 0.2, 0.3]);
        let frame = Frame::of(&x);
        let local = State::from_column_slice(&[12.0, -3.0, 9.0, 0.4, 0.0, 0.1, 0.2]);
        let map = frame.to_map(&local);
        let [px, py] = frame.position_to_local(map[P_X], map[P_Y]);
        assert!((px - 12.0).abs() < 1e-8 && (py + 3.0).abs() < 1e-8);
        assert!((frame.yaw_to_local(map[PSI] + 3.0 * TAU) - 0.4).abs() < 1e-12);
    }
}
