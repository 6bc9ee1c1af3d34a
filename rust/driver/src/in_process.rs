//! A driver whose answers are computed in the vehicle's own process.

use std::time::Duration;

use egp_wire::keys::Name;
use egp_wire::{Ready, Timing, WireError};
use prost::Message as _;

use crate::{Action, Driver, DriverConfig, DriverError, InvalidArgument, Measurement, Step, Time};

/// The answer to one request: the reply's bytes and where the time went.
pub type Answer = Result<(Vec<u8>, Timing), WireError>;

/// A [`Driver`] whose only replica is a function, such as an engine's step.
///
/// An answer counts whenever it comes: there is no other replica, so that giving the answer up would gain nothing.
#[derive(Clone, Debug)]
pub struct InProcessDriver {
    driver: Driver,
}

/// Constant time of the driver. With one replica that answers every query at once, no decision depends on time.
const NOW: Time = Time::ZERO;
/// Smallest budget of a request. A plan is computed even if the budget is used up.
const MIN_BUDGET: Duration = Duration::from_micros(1);

impl InProcessDriver {
    /// A driver for the library that `served` describes.
    ///
    /// # Errors
    /// [`DriverError`] when budget, hedge, limits or gate settings are out of range, or when the limits allow more than the
    /// vehicle that `served` describes can do.
    pub fn new(config: DriverConfig, served: Ready) -> Result<Self, DriverError> {
        // Queries do not leave the process, so that no key is needed.
        let mut driver = Driver::new(
            DriverConfig {
                key: None,
                ..config
            },
            served,
        )?;
        if let Ok(replica) = "in-process".parse::<Name>() {
            driver.replica_appeared(replica.clone());
            driver.replica_fits(&replica);
        }
        Ok(Self { driver })
    }

    /// The driver, for calls that concern neither time nor replicas.
    pub fn driver(&self) -> &Driver {
        &self.driver
    }

    /// Mutable access to the driver, for calls that concern neither time nor replicas.
    pub fn driver_mut(&mut self) -> &mut Driver {
        &mut self.driver
    }

    /// Counts a control period that cannot be opened; see [`Driver::skip_period`].
    pub fn skip_period(&mut self) {
        self.driver.skip_period(NOW);
    }

    /// One control period with the time `budget`, from 1 µs to 10 s, stated in the request; `answer` computes the reply's
    /// bytes from the request's.
    ///
    /// # Errors
    /// [`InvalidArgument`] if no request can be made from reference, widths or `road_friction`.
    pub fn step(
        &mut self,
        measurement: Measurement,
        budget: Duration,
        mut answer: impl FnMut(&[u8]) -> Answer,
    ) -> Result<Step, InvalidArgument> {
        let deadline = NOW + budget.max(MIN_BUDGET);
        self.driver.tick(NOW, deadline, measurement)?;
        loop {
            match self.driver.next_action() {
                Some(Action::Command(step)) => return Ok(*step),
                Some(Action::Ask(query)) => match answer(&query.payload) {
                    Ok((reply, timing)) => {
                        let timing = timing.encode_to_vec();
                        self.driver.replied(NOW, query.id, &reply, &timing);
                    }
                    Err(error) => self.driver.refused(NOW, query.id, &error.encode()),
                },
                Some(Action::Probe(query)) => self.driver.ended(NOW, query.id),
                // The period that `tick` opened is still open, because only a command ends it, and its deadline decides it
                // at the latest: the next action is the command.
                None => self.driver.wake(deadline),
            }
        }
    }
}
