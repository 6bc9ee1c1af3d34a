//! Hard limits of the actuators' values and slew rates.

use egp_parameters::VehicleParameters;

/// Limits of the commands to the actuators. All values are positive except `force_min`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Vehicle mass \[kg\]; turns the stopping deceleration into a force.
    pub mass: f64,
    /// Strongest braking force \[N\], negative.
    pub force_min: f64,
    /// Strongest driving force \[N\].
    pub force_max: f64,
    /// Motor power \[W\]: the driving force is at most `power / v_x`.
    pub power: f64,
    /// Change of the force per second \[N/s\].
    pub force_slew: f64,
    /// Steering angle \[rad\].
    pub steering_angle: f64,
    /// Steering rate \[rad/s\].
    pub steering_rate: f64,
    /// Change of the steering rate per second \[rad/s²\].
    pub steering_slew: f64,
}

/// A limit that is not finite or has the wrong sign.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("gate limit {name} must be finite and {expected}, got {value}")]
pub struct LimitsError {
    /// The field of [`Limits`] or argument of the gate.
    pub name: &'static str,
    /// The required range.
    pub expected: &'static str,
    /// The given value.
    pub value: f64,
}

/// A limit that allows more than the vehicle that plans are made for can do, or another mass.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "gate limit {name} is {gate} {unit}, the vehicle that plans are made for has {planned} {unit}{}; {}, or use a library \
     trained for the gate's vehicle",
    at_other_mass(self),
    advice(.name)
)]
pub struct WiderError {
    /// The field of [`Limits`].
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// The gate's value.
    pub gate: f64,
    /// That of the vehicle that plans are made for.
    pub planned: f64,
    /// Masses of the gate and of the vehicle that plans are made for, kg.
    pub masses: [f64; 2],
}

/// Relative difference between two limits that is rounding, such as that of numbers of 32 bits.
pub(crate) const ROUNDING: f64 = 1e-6;
/// Deceleration of a stop \[m/s²\] that wet roads hold, so that the wheels do not lock.
const STOP_DECELERATION: f64 = 3.0;
/// Largest relative difference between the masses of the same vehicle.
const SAME_MASS: f64 = 0.01;

/// `value` if it is finite and positive.
pub(crate) fn positive(name: &'static str, value: f64) -> Result<f64, LimitsError> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(LimitsError {
            name,
            expected: "positive",
            value,
        })
    }
}

/// What a limit on forces may be if the gate's vehicle is the heavier one, as a part of [`WiderError`]'s message.
fn at_other_mass(error: &WiderError) -> String {
    let [mass, planned_mass] = error.masses;
    if !(is_of_forces(error.name) && mass > planned_mass) {
        return String::new();
    }
    let (unit, most) = (error.unit, error.planned * (mass / planned_mass));
    // Nine significant digits leave out those of rounding, and are far within `ROUNDING`.
    let most = format!("{most:.8e}").parse().unwrap_or(most);
    format!(" at {planned_mass} kg, which is {most} {unit} at the gate's mass of {mass} kg")
}

/// Whether a limit is an acceleration, or its change or power, times the mass.
fn is_of_forces(name: &str) -> bool {
    matches!(name, "force_min" | "force_max" | "power" | "force_slew")
}

/// What to change in the gate; its mass cannot be narrowed.
fn advice(name: &str) -> &'static str {
    match name {
        "mass" => {
            "take the gate's limits from the vehicle that the library was trained for (a scenario states its file as \
             `vehicle_file`)"
        }
        _ => "narrow the gate",
    }
}

impl Limits {
    /// The limits of a vehicle: what its actuators can do, no more and no less.
    pub fn of(vehicle: &VehicleParameters) -> Self {
        Self {
            mass: vehicle.mass,
            force_min: vehicle.force(vehicle.a_min),
            force_max: vehicle.force(vehicle.a_max),
            power: vehicle.force(vehicle.power),
            force_slew: vehicle.force(vehicle.a_slew),
            steering_angle: vehicle.steering_angle,
            steering_rate: vehicle.steering_rate,
            steering_slew: vehicle.steering_slew,
        }
    }

    /// The deceleration of a stop \[m/s²\] where no other is stated: 3, or the strongest that the limits allow.
    pub fn stop_deceleration(&self) -> f64 {
        STOP_DECELERATION.min(-self.force_min / self.mass)
    }

    /// Checks that the gate lets nothing through that the vehicle which plans are made for cannot do, apart from a relative
    /// 1e-6 of rounding, and that its mass `m` is that vehicle's mass `M` within 1 %. A narrower gate is allowed: it then
    /// changes what a plan asks for.
    ///
    /// The bound of a force `F`, of a power and of a change of force is `max(1, m / M)` times that of the planned vehicle:
    ///
    /// * A heavier gate, `m > M`, is compared per mass, `F / m <= F_planned / M`, so that [`Limits::of`] the same vehicle with
    ///   another load fits. The driven vehicle then accelerates no more than the planned one, if `m` is its mass, and at most
    ///   1 % more if `M` is.
    /// * A lighter gate, `m < M`, is compared as it is, `F <= F_planned`: this is the force of the plans themselves, which are
    ///   made for the mass `M`. It accelerates the driven vehicle at most 1 % (`M / m`) more than the planned one.
    ///
    /// # Errors
    /// [`WiderError`] with both values, for the first field at fault.
    pub fn check_within(&self, planned: &VehicleParameters) -> Result<(), WiderError> {
        let masses = [self.mass, planned.mass];
        let heavier = (self.mass / planned.mass).max(1.0);
        let pairs = self.fields().into_iter().zip(Self::of(planned).fields());
        for ((name, unit, gate), (_, _, planned)) in pairs {
            let share = if is_of_forces(name) { heavier } else { 1.0 };
            let allowed = match name {
                "mass" => (gate - planned).abs() <= SAME_MASS * planned,
                _ => gate.abs() <= planned.abs() * share * (1.0 + ROUNDING),
            };
            if !allowed {
                return Err(WiderError {
                    name,
                    unit,
                    gate,
                    planned,
                    masses,
                });
            }
        }
        Ok(())
    }

    /// Name, unit and value of every field.
    pub fn fields(&self) -> [(&'static str, &'static str, f64); 8] {
        [
            ("mass", "kg", self.mass),
            ("force_min", "N", self.force_min),
            ("force_max", "N", self.force_max),
            ("power", "W", self.power),
            ("force_slew", "N/s", self.force_slew),
            ("steering_angle", "rad", self.steering_angle),
            ("steering_rate", "rad/s", self.steering_rate),
            ("steering_slew", "rad/s²", self.steering_slew),
        ]
    }

    /// Checks that all limits are finite and have the right sign.
    ///
    /// # Errors
    /// [`LimitsError`] with the first invalid field.
    pub fn validate(&self) -> Result<(), LimitsError> {
        for (name, _, value) in self.fields() {
            match name {
                "force_min" => positive("-force_min", -value)?,
                _ => positive(name, value)?,
            };
        }
        Ok(())
    }

    /// The force nearest to `wanted` that the limits allow at speed `v_x` after `previous`.
    ///
    /// The slew limit takes precedence: if the power limit falls faster than the slew limit allows, the force falls at
    /// full slew. The result lies in `[force_min, force_max]` because `previous` does.
    pub(crate) fn force(&self, wanted: f64, previous: f64, v_x: f64, dt: f64) -> f64 {
        let ceiling = self
            .force_max
            .min(self.power / v_x.abs().max(f64::MIN_POSITIVE));
        let step = self.force_slew * dt;
        wanted
            .clamp(self.force_min, ceiling)
            .clamp(previous - step, previous + step)
            .clamp(self.force_min, self.force_max) // removes the rounding error of the line above
    }

    /// The steering rate nearest to `wanted` that the limits allow at angle `delta` after `previous`.
    ///
    /// From the returned rate, the slew limit can still reduce the rate to zero before the angle exceeds its limit. The
    /// slew limit takes precedence, as for the force. Beyond a limit the wheels return, at a rate that can be reduced to zero
    /// before the other limit.
    pub(crate) fn steering_rate(&self, wanted: f64, previous: f64, delta: f64, dt: f64) -> f64 {
        let step = (self.steering_slew * dt).min(f64::MAX);
        let left = self.approach_rate(self.steering_angle - delta, step, dt);
        let right = -self.approach_rate(self.steering_angle + delta, step, dt);
        let allowed = if right <= left {
            wanted.clamp(right, left)
        } else if right.abs() < left.abs() {
            right
        } else {
            left
        };
        allowed
            .clamp(previous - step, previous + step)
            .clamp(-self.steering_rate, self.steering_rate)
    }

    /// Largest rate towards a limit that is `room` \[rad\] away.
    ///
    /// Slowing from rate `r` by `step` each period turns the wheel by `dt (r + (r - step) + ...) = dt ((n + 1) r - step
    /// n (n + 1) / 2)` with `n = floor(r / step)`. This is solved for `r`, and `n` follows from `room = dt step (n +
    /// 1)(n + 2) / 2`, where `n` changes. Beyond the limit (negative room) the rate points back.
    ///
    /// Room of more than a turn is treated as a turn, and the ratio of room to `step` is bounded, so that neither a measured
    /// angle nor a limit causes an overflow.
    fn approach_rate(&self, room: f64, step: f64, dt: f64) -> f64 {
        let turns = room.min(std::f64::consts::TAU) / dt;
        let rate = if turns > 0.0 {
            let ratio = (8.0 * turns / step).min(f64::MAX);
            let n = (0.5 * ((1.0 + ratio).sqrt() - 1.0)).floor();
            (turns + 0.5 * step * n * (n + 1.0)) / (n + 1.0)
        } else {
            turns
        };
        rate.clamp(-self.steering_rate, self.steering_rate)
    }
}
