//! Bounds of the speed along a path.

use std::ops::RangeInclusive;

use egp_parameters::{STANDARD_GRAVITY, VehicleParameters};

use crate::error::{PathError, check};

/// Largest share of the lateral peak of a surface's tyres that a reference uses; the rest is a reserve for corrections.
const TYRE_SHARE: f64 = 0.95;
/// Below the lowest known friction the lateral grip is at least this share of the lowest surface's.
const LEAST_SHARE: f64 = 0.5;

/// Speeds of a profile, m/s. Squares of other speeds, and times at them, could overflow.
pub(crate) const SPEEDS: RangeInclusive<f64> = 1e-3..=1e4;
/// [`SPEEDS`] in an error.
pub(crate) const SPEED: &str = "a speed from 0.001 to 10000 m/s";

/// Bounds of the speed. The friction circle of `mu g` is scaled in each direction, because a vehicle with one driven
/// axle and load transfer reaches far less of it in acceleration than in cornering.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedLimits {
    /// Fraction of the reachable accelerations to use, in `(0, 1]`.
    pub grip: f64,
    /// Reachable lateral acceleration as a fraction of `mu g`.
    pub lateral: f64,
    /// Lateral peaks of the tyres of single surfaces: rows of the friction coefficient `mu` and the largest lateral
    /// acceleration as a fraction of `mu g`, with increasing `mu`. Empty if they are not known.
    pub tyres: Vec<[f64; 2]>,
    /// Reachable deceleration as a fraction of `mu g`.
    pub braking: f64,
    /// Reachable acceleration as a fraction of `mu g`.
    pub driving: f64,
    /// Highest speed in m/s.
    pub v_max: f64,
    /// The vehicle's largest deceleration in m/s².
    pub a_brake: f64,
    /// The vehicle's largest acceleration in m/s².
    pub a_drive: f64,
    /// The vehicle's power per mass in W/kg, which limits the acceleration to `power / v`.
    pub power: f64,
    /// Speed limit in m/s at the start of an open path, if any. A [`crate::SpeedPlanner`] accepts none, because its plans
    /// begin at the vehicle.
    pub start_speed: Option<f64>,
    /// Speed limit in m/s at the end of an open path, if any.
    pub end_speed: Option<f64>,
}

impl SpeedLimits {
    /// What this vehicle can do at 80 % of its grip and at most 30 m/s.
    pub fn of(vehicle: &VehicleParameters) -> Self {
        Self {
            grip: 0.8,
            lateral: vehicle.lateral_grip,
            tyres: Vec::new(),
            braking: vehicle.braking_grip,
            driving: vehicle.driving_grip,
            v_max: 30.0,
            a_brake: -vehicle.a_min,
            a_drive: vehicle.a_max,
            power: vehicle.power,
            start_speed: None,
            end_speed: None,
        }
    }

    /// The largest lateral acceleration in m/s² of a reference on friction `mu`: the smaller of `grip lateral mu g` and
    /// 95 % of what the tyres transmit. The latter is interpolated linearly between surfaces. Below all of them the line
    /// through the two lowest is continued: where it meets zero above friction 0, a part of the lateral force does not
    /// depend on the friction, such as that of camber. Above all of them the share of the highest one is kept.
    pub(crate) fn lateral_acceleration(&self, mu: f64) -> f64 {
        let reference = self.lateral * (self.grip * mu * STANDARD_GRAVITY);
        let peak = |[friction, share]: [f64; 2]| share * friction;
        let most = match *self.tyres {
            [] => return reference,
            [[_, only]] => only * mu,
            [.., last] if mu >= last[0] => last[1] * mu,
            _ => {
                let above = self.tyres.partition_point(|[friction, _]| *friction <= mu);
                let (low, high) = (self.tyres[above.max(1) - 1], self.tyres[above.max(1)]);
                let part = (mu - low[0]) / (high[0] - low[0]);
                let line = peak(low) + part * (peak(high) - peak(low));
                line.max(LEAST_SHARE * low[1] * mu)
            }
        };
        reference.min(TYRE_SHARE * most * STANDARD_GRAVITY)
    }

    /// Errors if a limit is out of range, or if a closed path has a start or end speed.
    pub(crate) fn check(&self, closed: bool) -> Result<(), PathError> {
        check("grip", self.grip, "a fraction in (0, 1]", |g| {
            g > 0.0 && g <= 1.0
        })?;
        for (name, value) in [
            ("lateral", self.lateral),
            ("braking", self.braking),
            ("driving", self.driving),
            ("a_brake", self.a_brake),
            ("a_drive", self.a_drive),
            ("power", self.power),
        ] {
            check(name, value, "a positive number", |x| x > 0.0)?;
        }
        check("v_max", self.v_max, SPEED, |v| SPEEDS.contains(&v))?;
        let mut before = 0.0;
        for [friction, share] in &self.tyres {
            check("tyres", *friction, "increasing positive frictions", |mu| {
                mu > before
            })?;
            check("tyres", *share, "positive fractions of mu g", |x| x > 0.0)?;
            before = *friction;
        }
        for (name, speed) in [
            ("start_speed", self.start_speed),
            ("end_speed", self.end_speed),
        ] {
            match speed {
                Some(value) if closed => {
                    check(name, value, "nothing on a closed path", |_| false)?;
                }
                Some(value) => check(name, value, "a speed from 0 to 10000 m/s", |v| {
                    (0.0..=*SPEEDS.end()).contains(&v)
                })?,
                None => {}
            }
        }
        Ok(())
    }
}
