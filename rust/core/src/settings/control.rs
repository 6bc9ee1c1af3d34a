//! Settings of the optimal control problem, eqs. (15)-(18).

use serde::{Deserialize, Serialize};

use egp_parameters::{MOST_WIDTH, REFERENCE_SPEED};

use super::SettingsError;
use super::cost::MOST_WEIGHT;
use super::range::{LARGEST, check, positive, positive_if_stated};
use crate::NY;
use crate::qp::Penalty;

/// Which states the members are linearised about; the inputs are the previous plan's in both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Operating {
    /// The previous plan's own states (multiple shooting): differences to the ensemble's prediction enter as the affine
    /// term, so that one bad prediction does not displace all later states.
    Shift,
    /// The ensemble's prediction from the measured state under the previous plan's inputs.
    Rollout,
}

/// The operating trajectory, and the box inside which operating states are kept because members have training data there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct OperatingSettings {
    /// Default `shift`.
    pub kind: Operating,
    /// Lowest speed to linearise at, m/s, at most 100. Slip angles are not defined at standstill. Default `sqrt(scale)`.
    pub v_x_min: Option<f64>,
    /// Largest |v_y| to linearise at, in m/s. Default `8 sqrt(scale)`.
    pub v_y: Option<f64>,
    /// Largest |omega| to linearise at, in rad/s. Default `3 / sqrt(scale)`.
    pub omega: Option<f64>,
    /// When in a period, as a share of it, the yaw is taken along which positions move. Default 0.5: a vehicle in a bend
    /// moves along its chords. 0 is the paper's forward Euler method, along tangents that lead out of the bend.
    pub yaw_at: f64,
}

/// Hard bounds: the limits of the actuators and of the training data. By default those of the library's vehicle.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct InputBounds {
    /// Strongest braking, `F_x/m` in m/s². Default: the library's `a_min`.
    pub a_min: Option<f64>,
    /// Strongest drive, `F_x/m` in m/s². Default: the library's `a_max`.
    pub a_max: Option<f64>,
    /// Drive power per mass in W/kg: `F_x/m <= power/v_x`. Default: the library's `power`.
    pub power: Option<f64>,
    /// Steering rate in rad/s. Default: the library's `steering_rate`.
    pub delta_dot: Option<f64>,
    /// Change of `F_x/m` per second, m/s³. Default: the library's `a_slew`.
    pub a_slew: Option<f64>,
    /// Change of the steering rate per second, rad/s². Default: the library's `steering_slew`.
    pub delta_dot_slew: Option<f64>,
}

/// Penalty of a soft bound violated by `s`: `linear·s + ½ quadratic·s²`, at most 1e5 each.
///
/// The unit `l` of the defaults is the `scale` for lengths, `sqrt(scale)` for speeds, and 1 otherwise.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct PenaltySettings {
    /// Linear weight, 1 per unit of the bounded quantity. The penalty is exact: if this weight exceeds the multiplier of the
    /// hard bound, the bound is kept wherever that is feasible. Default `200 / l`.
    pub linear: Option<f64>,
    /// Quadratic weight, 1 per squared unit; it spreads an unavoidable violation over the stages. Default `2000 / l²`.
    pub quadratic: Option<f64>,
}

/// Soft bounds on states: they may be violated at the cost of a penalty, so that no measured state is infeasible.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct Soft {
    /// Highest speed in m/s; the lowest is 0. Default 60.
    pub v_x_max: f64,
    /// Largest steering angle in rad. Default: the library's `steering_angle`.
    pub delta: Option<f64>,
    /// Largest slip angle of the front tyres on friction 1, rad; on other surfaces it is multiplied by the friction of the
    /// blend. Violations cost the penalty `steering`. A value of 5 rad is never reached and switches the bound off. Default:
    /// [`crate::Member::slip_bound`] of the members, blended.
    pub slip: Option<f64>,
    /// Distance from the centre of mass to the front axle in m. Default: the library's `l_f`.
    pub front: Option<f64>,
    /// `[|v_y|, |omega|]` the plan should stay within, in m/s and rad/s; none by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub envelope: Option<[f64; 2]>,
    /// Distance kept between centre of mass and track edge, in m, at most 1000. Default: half the width of the library's
    /// vehicle and 0.263 m, which is 1.1 m for a width of 1.674 m; three quarters of the width of narrow vehicles.
    pub edge_margin: Option<f64>,
    /// Number of standard deviations of the plan's uncertainty by which track edges and the highest speed are tightened,
    /// at most 10. Default 0, which takes no time; `docs/settings.md` states what other values cost.
    pub caution: f64,
    /// Penalty of speed violations.
    pub speed: PenaltySettings,
    /// Penalty of steering-angle violations.
    pub steering: PenaltySettings,
    /// Penalty of leaving the track.
    pub track: PenaltySettings,
    /// Penalty of leaving the envelope.
    pub lateral_motion: PenaltySettings,
}

/// Which QP solver a step calls first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SolverKind {
    /// The Riccati solver: a dual active-set method, then an interior-point method. Clarabel is the fallback solver if the
    /// solution fails its check.
    Riccati,
    /// Clarabel alone.
    Clarabel,
}

impl SolverKind {
    /// Every choice.
    pub const ALL: [Self; 2] = [Self::Riccati, Self::Clarabel];
}

/// QP solver and the check every solution must pass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct SolverSettings {
    /// Default `riccati`.
    pub kind: SolverKind,
    /// Limit of the interior-point iterations; changes of the active set are counted in a reply as well, but are not limited by
    /// this. There is no time limit, which would make replies depend on the machine. Default 50.
    pub max_iterations: u32,
    /// Tolerance of the solver's stopping criteria. Of `riccati`: the largest violation of a bound, in the bound's unit (m/s²,
    /// rad/s, m/s, rad, m), and the residual of stationarity relative to its largest term. Of Clarabel: `tol_feas`. Default
    /// 1e-9.
    pub tolerance: f64,
    /// Largest KKT residual that a returned plan may have; it is computed independently of the solver. Default 1e-5.
    pub kkt_tolerance: f64,
}

impl Default for OperatingSettings {
    fn default() -> Self {
        Self {
            kind: Operating::Shift,
            v_x_min: None,
            v_y: None,
            omega: None,
            yaw_at: 0.5,
        }
    }
}

impl Default for Soft {
    fn default() -> Self {
        Self {
            v_x_max: 60.0,
            delta: None,
            slip: None,
            front: None,
            envelope: None,
            edge_margin: None,
            caution: 0.0,
            speed: PenaltySettings::default(),
            steering: PenaltySettings::default(),
            track: PenaltySettings::default(),
            lateral_motion: PenaltySettings::default(),
        }
    }
}

impl Default for SolverSettings {
    fn default() -> Self {
        Self {
            kind: SolverKind::Riccati,
            max_iterations: 50,
            tolerance: 1e-9,
            kkt_tolerance: 1e-5,
        }
    }
}

impl OperatingSettings {
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        if let Some(v_x_min) = self.v_x_min {
            check("operating.v_x_min", v_x_min, "from 1e-9 to 100 m/s", |v| {
                (1e-9..=REFERENCE_SPEED.1).contains(&v)
            })?;
        }
        positive_if_stated("operating.v_y", self.v_y)?;
        positive_if_stated("operating.omega", self.omega)?;
        check("operating.yaw_at", self.yaw_at, "in [0, 1]", |v| {
            (0.0..=1.0).contains(&v)
        })
    }

    /// `[v_x_min, v_y, omega]` for a vehicle of this scale.
    pub fn limits(&self, scale: f64) -> [f64; NY] {
        let root = scale.sqrt();
        [
            self.v_x_min.unwrap_or(root),
            self.v_y.unwrap_or(8.0 * root),
            self.omega.unwrap_or(3.0 / root),
        ]
    }

    /// The same settings with the values of [`Self::limits`] stated.
    pub(super) fn complete(&mut self, scale: f64) {
        let [v_x_min, v_y, omega] = self.limits(scale);
        (self.v_x_min, self.v_y, self.omega) = (Some(v_x_min), Some(v_y), Some(omega));
    }
}

impl InputBounds {
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        if let Some(a_min) = self.a_min {
            check("limits.a_min", a_min, "negative, from -1e9", |v| {
                (-LARGEST..0.0).contains(&v)
            })?;
        }
        positive_if_stated("limits.a_max", self.a_max)?;
        positive_if_stated("limits.power", self.power)?;
        positive_if_stated("limits.delta_dot", self.delta_dot)?;
        positive_if_stated("limits.a_slew", self.a_slew)?;
        positive_if_stated("limits.delta_dot_slew", self.delta_dot_slew)
    }
}

/// Distance kept between the vehicle's side and the track edge by default, m.
const EDGE_CLEARANCE: f64 = 0.263;
/// Largest value of that distance as a share of the vehicle's width.
const EDGE_SHARE: f64 = 0.25;

impl Soft {
    /// The distance kept between centre of mass and track edge, in m, by a vehicle `width` m wide.
    pub fn edge_margin(&self, width: f64) -> f64 {
        self.edge_margin
            .unwrap_or(0.5 * width + EDGE_CLEARANCE.min(EDGE_SHARE * width))
    }

    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        positive("soft.v_x_max", self.v_x_max)?;
        positive_if_stated("soft.delta", self.delta)?;
        positive_if_stated("soft.slip", self.slip)?;
        positive_if_stated("soft.front", self.front)?;
        for bound in self.envelope.iter().flatten() {
            positive("soft.envelope", *bound)?;
        }
        if let Some(margin) = self.edge_margin {
            check(
                "soft.edge_margin",
                margin,
                "not negative, at most 1000 m",
                |v| (0.0..=MOST_WIDTH).contains(&v),
            )?;
        }
        check("soft.caution", self.caution, "in [0, 10]", |v| {
            (0.0..=10.0).contains(&v)
        })?;
        for (linear, quadratic, bound) in [
            ("soft.speed.linear", "soft.speed.quadratic", self.speed),
            (
                "soft.steering.linear",
                "soft.steering.quadratic",
                self.steering,
            ),
            ("soft.track.linear", "soft.track.quadratic", self.track),
            (
                "soft.lateral_motion.linear",
                "soft.lateral_motion.quadratic",
                self.lateral_motion,
            ),
        ] {
            for (field, weight) in [(linear, bound.linear), (quadratic, bound.quadratic)] {
                weight.map_or(Ok(()), |weight| penalty(field, weight))?;
            }
        }
        Ok(())
    }

    /// The penalties of speed, steering, track and lateral motion for a vehicle of this scale.
    pub fn penalties(&self, scale: f64) -> [Penalty; 4] {
        let units = [scale.sqrt(), 1.0, scale, 1.0];
        let stated = [self.speed, self.steering, self.track, self.lateral_motion];
        std::array::from_fn(|i| stated[i].in_units_of(units[i]))
    }

    /// The same settings with the values of [`Self::penalties`] stated.
    pub(super) fn complete(&mut self, scale: f64) {
        [self.speed, self.steering, self.track, self.lateral_motion] =
            self.penalties(scale).map(|penalty| PenaltySettings {
                linear: Some(penalty.linear),
                quadratic: Some(penalty.quadratic),
            });
    }
}

impl PenaltySettings {
    /// The penalty, whose defaults are those of a quantity in this unit.
    fn in_units_of(&self, unit: f64) -> Penalty {
        Penalty {
            linear: (self.linear).unwrap_or_else(|| (200.0 / unit).min(MOST_WEIGHT)),
            quadratic: (self.quadratic)
                .unwrap_or_else(|| (2000.0 / (unit * unit)).min(MOST_WEIGHT)),
        }
    }
}

/// Errors unless `got` may be the penalty of a soft bound.
fn penalty(field: &'static str, got: f64) -> Result<(), SettingsError> {
    check(field, got, "from 1e-9 to 1e5", |v| {
        (1e-9..=MOST_WEIGHT).contains(&v)
    })
}

impl SolverSettings {
    pub(super) fn validate(&self) -> Result<(), SettingsError> {
        check(
            "solver.max_iterations",
            f64::from(self.max_iterations),
            "from 1 to 1000",
            |n| (1.0..=1000.0).contains(&n),
        )?;
        check("solver.tolerance", self.tolerance, "in (0, 1e-3]", |v| {
            v > 0.0 && v <= 1e-3
        })?;
        check(
            "solver.kkt_tolerance",
            self.kkt_tolerance,
            "in (0, 1e-2]",
            |v| v > 0.0 && v <= 1e-2,
        )
    }
}
