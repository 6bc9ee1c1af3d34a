//! Road surfaces, as factors on the curves of a tyre's force over slip.

/// Ratio of the lateral to the longitudinal friction coefficient of a surface that is given by one number.
const LATERAL_OVER_LONGITUDINAL: f64 = 0.9;

/// Coefficients `[B, C, D, E]` of the simplified magic formula `F / F_z = D sin(C atan(B k - E (B k - atan(B k))))` over
/// the longitudinal slip `k`: the typical values for dry tarmac, wet tarmac, snow and ice in the MathWorks documentation
/// of Simscape Driveline, page "Tire-Road Interaction (Magic Formula)".
const DRY_CURVE: [f64; 4] = [10.0, 1.9, 1.0, 0.97];
const WET_CURVE: [f64; 4] = [12.0, 2.3, 0.82, 1.0];
const SNOW_CURVE: [f64; 4] = [5.0, 2.0, 0.3, 1.0];
const ICE_CURVE: [f64; 4] = [4.0, 2.0, 0.1, 1.0];

/// The force of a tyre over its slip in one direction: the peak, and three factors on the tyre's own curve, which are
/// Pacejka's scaling factors `lambda`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceCurve {
    /// Friction coefficient: the ratio of the peak force to the load (`D`), > 0 and at most
    /// [`ForceCurve::MOST_PEAK`].
    pub peak: f64,
    /// Factor on the slope at zero slip (`B C D`), within [`ForceCurve::STIFFNESS`].
    pub stiffness: f64,
    /// Factor on the shape `C`, within [`ForceCurve::SHAPE`].
    pub shape: f64,
    /// Factor on the curvature `E`, within [`ForceCurve::CURVATURE`].
    pub curvature: f64,
}

impl ForceCurve {
    /// Largest friction coefficient; no tyre reaches it.
    pub const MOST_PEAK: f64 = 3.0;
    /// Range of the factor on the stiffness.
    pub const STIFFNESS: [f64; 2] = [1e-3, 10.0];
    /// Range of the factor on the shape. The shapes of the simulated tyre are 1.64 (longitudinal) and 1.35 (lateral).
    /// Below a shape of 1 the force does not reach its peak, and above 2 a tyre that slides would be pushed onward.
    pub const SHAPE: [f64; 2] = [0.75, 1.218];
    /// Range of the factor on the curvature. A curvature above 1 would also reverse the force of a tyre that slides; the
    /// largest one of the simulated tyre is 0.46.
    pub const CURVATURE: [f64; 2] = [0.0, 2.0];

    /// Whether [`ForceCurve::validate`] gives no error. The plant calls this function for each wheel in each substep, so
    /// there is no branch for each value.
    #[inline]
    #[allow(clippy::needless_bitwise_bool)]
    fn is_valid(&self) -> bool {
        let within = |value: f64, [low, high]: [f64; 2]| (value >= low) & (value <= high);
        within(self.peak, [f64::MIN_POSITIVE, Self::MOST_PEAK])
            & within(self.stiffness, Self::STIFFNESS)
            & within(self.shape, Self::SHAPE)
            & within(self.curvature, Self::CURVATURE)
    }

    fn validate(&self) -> Result<(), SurfaceError> {
        if !(f64::MIN_POSITIVE..=Self::MOST_PEAK).contains(&self.peak) {
            return Err(SurfaceError::Peak(self.peak));
        }
        for (name, value, [low, high]) in [
            ("stiffness", self.stiffness, Self::STIFFNESS),
            ("shape", self.shape, Self::SHAPE),
            ("curvature", self.curvature, Self::CURVATURE),
        ] {
            if !(low..=high).contains(&value) {
                return Err(SurfaceError::Factor {
                    name,
                    low,
                    high,
                    value,
                });
            }
        }
        Ok(())
    }
}

/// The force curves of a tyre on one road surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Force along the wheel.
    pub longitudinal: ForceCurve,
    /// Force across the wheel.
    pub lateral: ForceCurve,
    /// Factor on the lateral force that a wheel with camber has without slip, within [`Surface::SHIFT`]: Pacejka's
    /// `lambda_Vy lambda'_muy` in the vertical shift `S_Vy` (*Tire and Vehicle Dynamics*, 3rd ed., eq. 4.E29).
    pub shift: f64,
}

impl Surface {
    /// Range of the factor on the shift.
    pub const SHIFT: [f64; 2] = [0.0, 2.0];

    /// Dry tarmac: the tyre's own curve with friction 1.
    pub const DRY: Self = Self::published(DRY_CURVE);
    /// Wet tarmac.
    pub const WET: Self = Self::published(WET_CURVE);
    /// Snow.
    pub const SNOW: Self = Self::published(SNOW_CURVE);
    /// Ice.
    pub const ICE: Self = Self::published(ICE_CURVE);

    /// The presets with their names.
    pub const PRESETS: [(&'static str, Self); 4] = [
        ("dry", Self::DRY),
        ("wet", Self::WET),
        ("snow", Self::SNOW),
        ("ice", Self::ICE),
    ];

    /// The preset of a name, if there is one.
    pub fn named(name: &str) -> Option<Self> {
        let mut presets = Self::PRESETS.into_iter();
        presets.find_map(|(own, surface)| (own == name).then_some(surface))
    }

    /// A surface with the same factors in both directions, a lateral peak of `0.9 peak` and the tyre's own shift.
    pub const fn new(peak: f64, stiffness: f64, shape: f64, curvature: f64) -> Self {
        let longitudinal = ForceCurve {
            peak,
            stiffness,
            shape,
            curvature,
        };
        Self {
            longitudinal,
            lateral: ForceCurve {
                peak: LATERAL_OVER_LONGITUDINAL * peak,
                ..longitudinal
            },
            shift: 1.0,
        }
    }

    /// A surface of the published set: the peak is `D`, and the factors are the ratios of `B C D`, `C`, `E` and, on the
    /// shift, of `D` to those of dry tarmac.
    const fn published([b, c, d, e]: [f64; 4]) -> Self {
        let [b_dry, c_dry, d_dry, e_dry] = DRY_CURVE;
        let stiffness = (b * c * d) / (b_dry * c_dry * d_dry);
        Self {
            shift: d / d_dry,
            ..Self::new(d, stiffness, c / c_dry, e / e_dry)
        }
    }

    /// The friction coefficient `mu`: the longitudinal peak, by which surfaces are labelled and speeds are planned.
    pub fn friction(&self) -> f64 {
        self.longitudinal.peak
    }

    /// The surface for a worn tyre, which has the share `left` of a new tyre's peak and stiffness.
    #[inline]
    #[must_use]
    pub fn worn(&self, left: f64) -> Self {
        let scaled = |curve: &ForceCurve| ForceCurve {
            peak: left * curve.peak,
            stiffness: left * curve.stiffness,
            ..*curve
        };
        Self {
            longitudinal: scaled(&self.longitudinal),
            lateral: scaled(&self.lateral),
            shift: self.shift,
        }
    }

    /// Errors unless both peaks are positive and at most [`ForceCurve::MOST_PEAK`], and all factors are within their ranges.
    ///
    /// # Errors
    /// [`SurfaceError`] with the first value out of range.
    #[inline]
    #[allow(clippy::needless_bitwise_bool)]
    pub fn validate(&self) -> Result<(), SurfaceError> {
        let [low, high] = Self::SHIFT;
        let shifted = (self.shift >= low) & (self.shift <= high);
        if self.longitudinal.is_valid() & self.lateral.is_valid() & shifted {
            return Ok(());
        }
        self.longitudinal.validate()?;
        self.lateral.validate()?;
        Err(SurfaceError::Factor {
            name: "shift",
            low,
            high,
            value: self.shift,
        })
    }
}

/// The surface of a friction coefficient alone: the tyre's own curves with the peaks `mu` and `0.9 mu`.
impl From<f64> for Surface {
    fn from(mu: f64) -> Self {
        Self::new(mu, 1.0, 1.0, 1.0)
    }
}

/// A surface for which the tyre has no force law.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// A peak that is not positive, or is above [`ForceCurve::MOST_PEAK`].
    #[error(
        "expected a friction coefficient > 0 and at most {most}, got {0}; dry asphalt is about 1, ice 0.1",
        most = ForceCurve::MOST_PEAK
    )]
    Peak(f64),
    /// A factor out of its range.
    #[error("expected a factor from {low} to {high} on the {name} of a surface, got {value}")]
    Factor {
        /// The field of [`ForceCurve`].
        name: &'static str,
        /// Smallest factor.
        low: f64,
        /// Largest factor.
        high: f64,
        /// The given value.
        value: f64,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_ratios_to_dry_tarmac() {
        assert_eq!(Surface::DRY, Surface::from(1.0));
        assert_eq!(Surface::SNOW.shift, 0.3);
        let snow = Surface::named("snow").map(|snow| snow.longitudinal);
        assert_eq!(snow, Some(Surface::SNOW.longitudinal));
        assert_eq!(Surface::named("mud"), None);
        // 5 * 2 * 0.3 of 10 * 1.9 * 1, 2 of 1.9 and 1 of 0.97.
        let ForceCurve {
            peak,
            stiffness,
            shape,
            curvature,
        } = Surface::SNOW.lateral;
        for (got, expected) in [
            (peak, 0.27),
            (stiffness, 0.157_894_736_8),
            (shape, 1.052_631_578_9),
            (curvature, 1.030_927_835_1),
        ] {
            assert!((got - expected).abs() < 1e-9, "{got} {expected}");
        }
    }

    #[test]
    fn a_surface_out_of_range_is_an_error() {
        for (_, surface) in Surface::PRESETS {
            assert_eq!(surface.validate(), Ok(()));
        }
        assert_eq!(
            Surface::from(-0.1).validate(),
            Err(SurfaceError::Peak(-0.1))
        );
        assert!(Surface::from(f64::NAN).validate().is_err());
        assert_eq!(Surface::from(3.0).validate(), Ok(()));
        assert_eq!(Surface::from(8.0).validate(), Err(SurfaceError::Peak(8.0)));
        for bad in [
            Surface::new(0.5, 0.0, 1.0, 1.0),
            Surface::new(0.5, 1.0, 1.3, 1.0),
            Surface::new(0.5, 1.0, 1.0, f64::NAN),
        ] {
            assert!(matches!(bad.validate(), Err(SurfaceError::Factor { .. })));
        }
        let shifted = Surface {
            shift: f64::NAN,
            ..Surface::DRY
        };
        assert!(matches!(
            shifted.validate(),
            Err(SurfaceError::Factor { name: "shift", .. })
        ));
        let mut slippery_across = Surface::from(0.5);
        slippery_across.lateral.peak = 0.0;
        assert_eq!(slippery_across.validate(), Err(SurfaceError::Peak(0.0)));
    }
}
