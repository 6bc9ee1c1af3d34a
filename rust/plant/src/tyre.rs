//! The tyre: Pacejka's magic formula with combined slip.
//!
//! H. B. Pacejka, "Tire and Vehicle Dynamics", 3rd ed., section 4.3.2, without turn slip, with the simplifications of
//! the CommonRoad vehicles (shape and stiffness do not vary with load, no ply-steer terms).

use egp_parameters::{ForceCurve, Surface};

/// Coefficients named as in the reference: `p` pure slip, `r` combined slip, `x` longitudinal, `y` lateral,
/// `b c d e k` stiffness, shape, peak, curvature and slip stiffness factors, `h v` horizontal and vertical shifts.
///
/// The peaks `p_dx1` and `p_dy1` are not parameters; they are the friction of the surface. Its factors scale the pure-slip
/// stiffness `k`, shape `c` and curvature `e` and the vertical shift of the lateral force as Pacejka's `lambda` do; the
/// coefficients of combined slip and the other shifts are the same on all surfaces.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)]
pub struct TyreParameters {
    pub p_cx1: f64,
    pub p_dx3: f64,
    pub p_ex1: f64,
    pub p_kx1: f64,
    pub p_hx1: f64,
    pub p_vx1: f64,
    pub r_bx1: f64,
    pub r_bx2: f64,
    pub r_cx1: f64,
    pub r_ex1: f64,
    pub r_hx1: f64,
    pub p_cy1: f64,
    pub p_dy3: f64,
    pub p_ey1: f64,
    pub p_ky1: f64,
    pub p_hy1: f64,
    pub p_hy3: f64,
    pub p_vy1: f64,
    pub p_vy3: f64,
    pub r_by1: f64,
    pub r_by2: f64,
    pub r_by3: f64,
    pub r_cy1: f64,
    pub r_ey1: f64,
    pub r_hy1: f64,
    pub r_vy1: f64,
    pub r_vy3: f64,
    pub r_vy4: f64,
    pub r_vy5: f64,
    pub r_vy6: f64,
}

impl TyreParameters {
    /// The tyre of all CommonRoad vehicles, from the ADAMS handbook.
    pub const ADAMS: Self = Self {
        p_cx1: 1.6411,
        p_dx3: 0.0,
        p_ex1: 0.464_03,
        p_kx1: 22.303,
        p_hx1: 0.001_229_7,
        p_vx1: -8.8098e-6,
        r_bx1: 13.276,
        r_bx2: -13.778,
        r_cx1: 1.2568,
        r_ex1: 0.652_25,
        r_hx1: 0.005_072_2,
        p_cy1: 1.3507,
        p_dy3: -2.8821,
        p_ey1: -0.007_472_2,
        p_ky1: -21.92,
        p_hy1: 0.002_674_7,
        p_hy3: 0.031_415,
        p_vy1: 0.037_318,
        p_vy3: -0.329_31,
        r_by1: 7.1433,
        r_by2: 9.1916,
        r_by3: -0.027_856,
        r_cy1: 1.0719,
        r_ey1: -0.275_72,
        r_hy1: 5.7448e-6,
        r_vy1: -0.027_825,
        r_vy3: -0.275_68,
        r_vy4: 12.12,
        r_vy5: 1.9,
        r_vy6: -10.704,
    };
}

/// Slip, load and surface of a tyre's contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact<'a> {
    /// Longitudinal slip `1 - R w / u`: 0 rolling, 1 locked, negative when driven.
    pub slip: f64,
    /// Slip angle, rad.
    pub slip_angle: f64,
    /// Camber, rad.
    pub camber: f64,
    /// Vertical load, N.
    pub load: f64,
    /// The surface under this wheel.
    pub surface: &'a Surface,
}

/// Force of the road on a tyre in the wheel's axes, N.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TyreForce {
    /// Longitudinal force, positive forward.
    pub x: f64,
    /// Lateral force.
    pub y: f64,
}

impl TyreParameters {
    /// Force under combined slip.
    pub fn force(&self, contact: &Contact<'_>) -> TyreForce {
        let &Contact {
            slip,
            slip_angle,
            camber,
            load,
            surface,
        } = contact;
        let mu_y = surface.lateral.peak * (1.0 - self.p_dy3 * camber * camber);
        let pure_x = self.pure_longitudinal(slip, camber, load, &surface.longitudinal);
        let pure_y = self.pure_lateral(slip_angle, camber, load, mu_y, surface);

        let b_x = self.r_bx1 * cos_atan(self.r_bx2 * slip);
        let weight_x = reduction(b_x, self.r_cx1, self.r_ex1, self.r_hx1, slip_angle);

        let b_y = self.r_by1 * cos_atan(self.r_by2 * (slip_angle - self.r_by3));
        let weight_y = reduction(b_y, self.r_cy1, self.r_ey1, self.r_hy1, slip);
        let induced = mu_y
            * load
            * (self.r_vy1 + self.r_vy3 * camber)
            * cos_atan(self.r_vy4 * slip_angle)
            * (self.r_vy5 * (self.r_vy6 * slip).atan()).sin();

        TyreForce {
            x: weight_x * pure_x,
            y: weight_y * pure_y + induced,
        }
    }

    /// `D sin(C atan(..) + S_v)`, with the shift inside the sine as in the original.
    fn pure_longitudinal(&self, slip: f64, camber: f64, load: f64, curve: &ForceCurve) -> f64 {
        let mu_x = curve.peak * (1.0 - self.p_dx3 * camber * camber);
        let shift = load * self.p_vx1;
        // The load cancels in B because B C D = K = p_kx1 load, so an unloaded tyre needs no special case.
        let (k, c) = (curve.stiffness * self.p_kx1, curve.shape * self.p_cx1);
        let e = curve.curvature * self.p_ex1;
        let angle = magic_angle(k / (c * mu_x), c, e, self.p_hx1 - slip);
        mu_x * load * (angle + shift).sin()
    }

    /// `D sin(C atan(..)) + S_v`; the sign of both shifts is that of the camber.
    fn pure_lateral(
        &self,
        slip_angle: f64,
        camber: f64,
        load: f64,
        mu_y: f64,
        surface: &Surface,
    ) -> f64 {
        let curve = &surface.lateral;
        let side = if camber == 0.0 { 0.0 } else { camber.signum() };
        let horizontal = side * (self.p_hy1 + self.p_hy3 * camber.abs());
        let vertical = surface.shift * side * load * (self.p_vy1 + self.p_vy3 * camber.abs());
        let (k, c) = (curve.stiffness * self.p_ky1, curve.shape * self.p_cy1);
        let e = curve.curvature * self.p_ey1;
        let angle = magic_angle(k / (c * mu_y), c, e, slip_angle + horizontal);
        mu_y * load * angle.sin() + vertical
    }
}

/// Pacejka's `C atan(B x - E (B x - atan(B x)))`, rearranged so that an infinite `B x` does not give NaN.
fn magic_angle(b: f64, c: f64, e: f64, x: f64) -> f64 {
    let bx = b * x;
    c * ((1.0 - e) * bx + e * bx.atan()).atan()
}

/// The weighting factor of combined slip: a cosine magic formula that is 1 if the other slip is zero.
fn reduction(b: f64, c: f64, e: f64, shift: f64, other_slip: f64) -> f64 {
    magic_angle(b, c, e, other_slip + shift).cos() / magic_angle(b, c, e, shift).cos()
}

/// `cos(atan(x))`.
fn cos_atan(x: f64) -> f64 {
    1.0 / (1.0 + x * x).sqrt()
}
