//! Weights of the cost of eq. (18).

use serde::{Deserialize, Serialize};

use super::SettingsError;
use super::range::{check, not_negative, positive};
use crate::NU;

/// Largest accepted weight of a state, and penalty of a soft bound. With larger ones some steps end without a plan.
pub(super) const MOST_WEIGHT: f64 = 1e5;
/// Largest accepted factor of the states' weights at the last stage, which low friction raises up to 20 times.
const MOST_TERMINAL: f64 = 1e3;

/// Weights of the quadratic cost; every term is `½ weight · error²`. Those of states and `proximal` are at most 1e5, and
/// `terminal` at most 1e3: with 1e9 many problems have no solution that passes the check.
///
/// Defaults follow the [`scale`](egp_parameters::VehicleParameters::scale) of the vehicle, so that small vehicles are driven
/// as full-size vehicles of similar shape are. Those above 1e5 are 1e5.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct Cost {
    /// Position error along the reference, 1/m². If it equals `lateral`, Q is the same for all yaw angles of the reference,
    /// as in the paper, except below [`ScaledWeights::full_lateral_speed`]. Default `2 / scale²`.
    pub longitudinal: Option<f64>,
    /// Position error across the reference, 1/m², with less weight below [`ScaledWeights::full_lateral_speed`]. Default
    /// `80 / scale²`; with 80 the simulated car drives with up to 40 ms of actuator delay, with 20 with up to 60 ms.
    pub lateral: Option<f64>,
    /// Speed error, 1/(m/s)². Default `2 / scale`.
    pub v_x: Option<f64>,
    /// Yaw error, 1/rad². Default 10.
    pub psi: f64,
    /// Factor of the state weights at the last stage on a surface with the friction 1; it is inversely proportional to the
    /// friction on those with less: `Q_T = terminal / mu · Q` with `mu` limited to 0.05 to 1. Default 2.
    pub terminal: f64,
    /// `R` on `[F_x/m, delta_dot]`, 1/(m/s²)² and 1/(rad/s)². Default `[0.05, 2 scale]`.
    pub input: Option<[f64; NU]>,
    /// `R_d` on the change of `[F_x/m, delta_dot]` from stage to stage, the first from the applied input.
    /// Default `[0.05, 10 scale]`.
    pub rate: Option<[f64; NU]>,
    /// Weight of the change of `F_x/m` from the previous plan, as a multiple of the bound on the curvature that the
    /// linearisation leaves out, which is zero where lateral force is not scarce. 0 is none, as in the paper. Default 2.
    pub proximal: f64,
}

/// The weights of [`Cost`] whose defaults follow the scale of the vehicle, for one vehicle.
#[derive(Debug, Clone, Copy)]
pub struct ScaledWeights {
    /// [`Cost::longitudinal`].
    pub longitudinal: f64,
    /// [`Cost::lateral`].
    pub lateral: f64,
    /// Reference speed `v_0` in m/s, `4 √scale`, below which the weight of lateral errors is `lateral (v_x / v_0)²`.
    pub full_lateral_speed: f64,
    /// [`Cost::v_x`].
    pub v_x: f64,
    /// [`Cost::input`].
    pub input: [f64; NU],
    /// [`Cost::rate`].
    pub rate: [f64; NU],
}

impl Default for Cost {
    fn default() -> Self {
        Self {
            longitudinal: None,
            lateral: None,
            v_x: None,
            psi: 10.0,
            terminal: 2.0,
            input: None,
            rate: None,
            proximal: 2.0,
        }
    }
}

impl Cost {
    /// The weights whose defaults follow the scale, for a vehicle of this scale.
    pub fn scaled(&self, scale: f64) -> ScaledWeights {
        let per_square = |weight: f64, unit: f64| (weight / (unit * unit)).min(MOST_WEIGHT);
        ScaledWeights {
            longitudinal: (self.longitudinal).unwrap_or_else(|| per_square(2.0, scale)),
            lateral: self.lateral.unwrap_or_else(|| per_square(80.0, scale)),
            full_lateral_speed: 4.0 * scale.sqrt(),
            v_x: self.v_x.unwrap_or(2.0 / scale),
            input: self.input.unwrap_or([0.05, 2.0 * scale]),
            rate: self.rate.unwrap_or([0.05, 10.0 * scale]),
        }
    }

    /// The same settings with the weights of [`Self::scaled`] stated.
    pub(super) fn complete(&mut self, scale: f64) {
        let scaled = self.scaled(scale);
        self.longitudinal = Some(scaled.longitudinal);
        self.lateral = Some(scaled.lateral);
        self.v_x = Some(scaled.v_x);
        self.input = Some(scaled.input);
        self.rate = Some(scaled.rate);
    }

    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        weight_if_stated("cost.longitudinal", self.longitudinal)?;
        weight_if_stated("cost.lateral", self.lateral)?;
        weight_if_stated("cost.v_x", self.v_x)?;
        weight("cost.psi", self.psi)?;
        check(
            "cost.terminal",
            self.terminal,
            "not negative, at most 1e3",
            |v| (0.0..=MOST_TERMINAL).contains(&v),
        )?;
        weight("cost.proximal", self.proximal)?;
        for input in self.input.iter().flatten() {
            positive("cost.input", *input)?; // keeps the QP strictly convex: one solution
        }
        for rate in self.rate.iter().flatten() {
            not_negative("cost.rate", *rate)?;
        }
        Ok(())
    }
}

fn weight_if_stated(field: &'static str, got: Option<f64>) -> Result<(), SettingsError> {
    got.map_or(Ok(()), |value| weight(field, value))
}

/// Errors unless `got` may be the weight of a state.
fn weight(field: &'static str, got: f64) -> Result<(), SettingsError> {
    check(field, got, "not negative, at most 1e5", |v| {
        (0.0..=MOST_WEIGHT).contains(&v)
    })
}

#[cfg(test)]
mod tests {
    use egp_parameters::VehicleParameters;

    use crate::Settings;

    const CAR: VehicleParameters = VehicleParameters::FORD_ESCORT;

    /// The settings of a vehicle with the car's shape and `scale` times the size of a full-size one.
    fn settings(scale: f64) -> Settings {
        let wheelbase = CAR.l_f + CAR.l_r;
        let vehicle = VehicleParameters {
            l_f: 2.0 * scale * CAR.l_f / wheelbase,
            l_r: 2.0 * scale * CAR.l_r / wheelbase,
            ..CAR
        };
        Settings::default().complete(0.02, 1.0, &vehicle, None, None)
    }

    /// Errors of vehicles of similar shape cost the same: a quarter of the size means a quarter of the distance, half of the
    /// speed, and twice the yaw rate.
    #[test]
    fn errors_of_similar_vehicles_cost_the_same() {
        let (large, small) = (settings(1.0), settings(0.25));
        assert_eq!(settings(1.2).cost, large.cost);
        assert_eq!(large.cost.lateral, Some(80.0));
        assert_eq!(small.cost.lateral, Some(80.0 * 16.0));
        assert_eq!(small.cost.longitudinal, Some(2.0 * 16.0));
        assert_eq!(small.cost.v_x, Some(2.0 * 4.0));
        assert_eq!(small.cost.input, Some([0.05, 2.0 / 4.0]));
        assert_eq!(small.cost.rate, Some([0.05, 10.0 / 4.0]));
        assert_eq!(small.soft.track.linear, Some(200.0 * 4.0));
        assert_eq!(small.soft.track.quadratic, Some(2000.0 * 16.0));
        assert_eq!(small.soft.speed.linear, Some(200.0 * 2.0));
        assert_eq!(small.soft.steering, large.soft.steering);
        assert_eq!(small.operating.v_x_min, Some(0.5));
        assert_eq!(
            (small.operating.v_y, small.operating.omega),
            (Some(4.0), Some(6.0))
        );
        assert!(settings(0.01).validate().is_ok());
    }

    #[test]
    fn what_is_stated_does_not_depend_on_the_size() {
        let mut stated = Settings::default();
        stated.cost.lateral = Some(7.0);
        stated.soft.track.linear = Some(8.0);
        let small = VehicleParameters {
            l_f: 0.16,
            l_r: 0.17,
            ..CAR
        };
        let complete = stated.complete(0.02, 1.0, &small, None, None);
        assert_eq!(complete.cost.lateral, Some(7.0));
        assert_eq!(complete.soft.track.linear, Some(8.0));
    }
}
