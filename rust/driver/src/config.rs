//! What a driver needs to know before the first control period.

use std::time::Duration;

use egp_gate::{Gate, GateError, Limits, WiderError};
use egp_wire::keys::{Name, NameError};
use egp_wire::{Ready, Seal, Tag, Timing, VehicleKey};
use prost::Message as _;
use thiserror::Error;

/// Why a driver cannot be made.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DriverError {
    /// The gate's limits or settings are not valid.
    #[error(transparent)]
    Gate(#[from] GateError),
    /// The gate allows more than the vehicle that the service plans for can do, or has another mass.
    #[error(transparent)]
    Wider(#[from] WiderError),
    /// The budget is outside its range.
    #[error("the budget must be in (0, 1] of the control period, got {0}")]
    Budget(f64),
    /// The time of the second question is outside its range.
    #[error("hedge must be in (0, 1] of the time until the deadline, got {0}")]
    Hedge(f64),
}

/// Configuration of a [`crate::Driver`].
#[derive(Clone, Debug)]
pub struct DriverConfig {
    /// Fleet that the vehicle belongs to.
    pub fleet: Name,
    /// Name of the vehicle in its fleet.
    pub vehicle: Name,
    /// Part of the control period that an answer may take, in (0, 1]. Default 0.8.
    pub budget: f64,
    /// Part of the time until the deadline, in (0, 1], after which the next replica is asked as well if none has
    /// answered; the first answer counts. At most one period in twenty does this in the long run, so that replicas that
    /// are slow because they are busy do not get twice the load. With the value 1, replicas are asked only one after the other.
    /// Default 0.5.
    pub hedge: f64,
    /// Limits of the actuators.
    pub limits: Limits,
    /// Control periods that the rest of a plan may bridge. Default: half a second, which is 25 periods of 0.02 s
    /// ([`Gate::default_tail_ticks`]).
    pub max_tail_ticks: Option<u64>,
    /// Deceleration of a stop, m/s². Default 3, or the strongest that the limits allow.
    pub stop_deceleration: f64,
    /// Whether to ask for the predicted standard deviations. Default false.
    pub want_sigma: bool,
    /// The vehicle's secret key: questions are sealed with it, and only answers with its tag are used. Default none.
    pub key: Option<RunKey>,
}

/// The secret key of a vehicle, and the number of this run of its client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunKey {
    /// The key.
    pub key: VehicleKey,
    /// A random number, so that answers to an earlier run are of no use in this one.
    pub run: u64,
}

impl DriverConfig {
    /// Defaults for a vehicle of this name with these actuator limits.
    ///
    /// # Errors
    /// [`NameError`] when fleet or vehicle is not 1 to 64 of the characters `A-Z a-z 0-9 . _ -`.
    pub fn new(fleet: &str, vehicle: &str, limits: Limits) -> Result<Self, NameError> {
        Ok(Self {
            fleet: fleet.parse()?,
            vehicle: vehicle.parse()?,
            budget: 0.8,
            hedge: 0.5,
            limits,
            max_tail_ticks: None,
            stop_deceleration: limits.stop_deceleration(),
            want_sigma: false,
            key: None,
        })
    }

    /// The attachment of a question on `key`, and its tag; nothing without a secret key.
    pub(crate) fn seal(&self, key: &str, number: u64, payload: &[u8]) -> (Vec<u8>, Option<Tag>) {
        let Some(RunKey { key: secret, run }) = &self.key else {
            return (Vec::new(), None);
        };
        let tag = secret.question(key, *run, number, payload);
        let seal = Seal {
            vehicle: (self.fleet.clone(), self.vehicle.clone()),
            run: *run,
            number,
            tag,
        };
        (seal.encode(), Some(tag))
    }

    /// Whether an answer may be used: it has the tag of the question's answer, or there is no secret key.
    pub(crate) fn authentic(
        &self,
        question: Option<&Tag>,
        payload: &[u8],
        attachment: &[u8],
    ) -> bool {
        let (Some(RunKey { key, .. }), Some(question)) = (&self.key, question) else {
            return self.key.is_none();
        };
        Timing::decode(attachment).is_ok_and(|timing| key.is_answer(question, payload, &timing.tag))
    }

    /// Whether a replica with this description answers only requests with a seal, which this vehicle has no key for.
    pub(crate) fn lacks_key(&self, ready: &Ready) -> bool {
        ready.sealed && self.key.is_none()
    }

    /// Checks everything that does not depend on what a replica serves.
    ///
    /// # Errors
    /// [`DriverError`] when budget, hedge, limits or gate settings are out of range.
    pub(crate) fn validate(&self) -> Result<(), DriverError> {
        let any_dt = 1.0;
        self.gate(any_dt)?;
        self.budget(any_dt)?;
        self.hedge()?;
        Ok(())
    }

    /// The gate for control periods of `dt` s.
    ///
    /// # Errors
    /// [`GateError`] when limits or gate settings are out of range.
    pub(crate) fn gate(&self, dt: f64) -> Result<Gate, GateError> {
        Gate::new(self.limits, dt, self.tail_ticks(dt), self.stop_deceleration)
    }

    /// Control periods of `dt` s that the rest of a plan may bridge.
    pub(crate) fn tail_ticks(&self, dt: f64) -> u64 {
        self.max_tail_ticks
            .unwrap_or_else(|| Gate::default_tail_ticks(dt))
    }

    /// The time that an answer may take in a control period of `dt` s.
    ///
    /// # Errors
    /// [`DriverError::Budget`] when the budget is outside (0, 1].
    pub(crate) fn budget(&self, dt: f64) -> Result<Duration, DriverError> {
        if self.budget > 0.0 && self.budget <= 1.0 {
            Ok(Duration::from_secs_f64(dt * self.budget))
        } else {
            Err(DriverError::Budget(self.budget))
        }
    }

    /// The part of the time until the deadline after which a second replica is asked.
    ///
    /// # Errors
    /// [`DriverError::Hedge`] when it is outside (0, 1].
    pub(crate) fn hedge(&self) -> Result<f64, DriverError> {
        if self.hedge > 0.0 && self.hedge <= 1.0 {
            Ok(self.hedge)
        } else {
            Err(DriverError::Hedge(self.hedge))
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use egp_parameters::VehicleParameters;

    use super::*;

    #[test]
    fn the_budget_is_a_share_of_the_period() {
        let limits = Limits::of(&VehicleParameters::FORD_ESCORT);
        let config = DriverConfig::new("fleet", "car", limits).unwrap();
        let with = |budget: f64| DriverConfig {
            budget,
            ..config.clone()
        };
        for (budget, milliseconds) in [(1.0, 50), (0.5, 25)] {
            let budget = with(budget).budget(0.05).unwrap();
            assert_eq!(budget, Duration::from_millis(milliseconds));
        }
        for budget in [0.0, -0.5, 1.0 + 1e-9] {
            let error = with(budget).budget(0.05).unwrap_err();
            assert_eq!(error, DriverError::Budget(budget));
        }
        assert!(with(f64::NAN).budget(0.05).is_err());
    }
}
