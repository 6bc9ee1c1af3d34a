//! The client of one vehicle, which carries out the driver's actions over zenoh.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use egp_driver::{
    Action, Discovery, DiscoveryError, Driver, DriverConfig, DriverError, InvalidArgument,
    Measurement, Step, Time,
};
use egp_gate::Mode;
use egp_session::NetworkError;
use egp_wire::keys::Name;
use egp_wire::{ReferenceRow, State, WidthRow};
use prost::Message as _;
use thiserror::Error;

use crate::config::VehicleConfig;
use crate::network::{Event, EventKind, Network};
use crate::reach::unreached;
use crate::status::{Constants, Period, Status};
use crate::traces::{StepTraces, StepTracesError};

/// Why a client cannot connect, or a control period cannot be opened.
#[derive(Debug, Error)]
pub enum ClientError {
    /// zenoh reports an error.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// No replica announces itself, or none can be used.
    #[error("{reason}; waited {patience:?} at {}, {}", places(.endpoints), why(.reason, .unreached))]
    NoReplica {
        /// What is wrong with each replica.
        reason: DiscoveryError,
        /// How long the client waited.
        patience: Duration,
        /// Where it connected to; empty if the zenoh file says where.
        endpoints: Vec<String>,
        /// What the system says of each of these endpoints at which no program accepts connections.
        unreached: Vec<String>,
    },
    /// The system gives no random number, which a run with a key and the publication of the status need.
    #[error("the system gives no random number: {0}")]
    Random(getrandom::Error),
    /// Budget, hedge, limits or gate settings are out of range, or the limits allow more than the vehicle that plans are made
    /// for can do, or have another mass.
    #[error(transparent)]
    Driver(#[from] DriverError),
    /// The spans of control steps cannot be written.
    #[error(transparent)]
    Traces(#[from] StepTracesError),
    /// No request can be made of the reference, the widths or `road_friction`.
    #[error(transparent)]
    Argument(#[from] InvalidArgument),
}

/// The endpoints as a message names them.
fn places(endpoints: &[String]) -> String {
    if endpoints.is_empty() {
        "the endpoints of the zenoh file".to_owned()
    } else {
        endpoints.join(", ")
    }
}

/// What to look for if no replica can be used.
fn why(reason: &DiscoveryError, unreached: &[String]) -> String {
    if unreached.is_empty() && reason.0.is_empty() {
        "is the service running there? With TLS, a certificate may be missing, have expired or be of another authority"
            .to_owned()
    } else if unreached.is_empty() {
        "is the service running there?".to_owned()
    } else {
        format!("where there is no link: {}", unreached.join("; "))
    }
}

/// Driver and network of one vehicle.
pub struct VehicleClient {
    network: Network,
    driver: Driver,
    epoch: Instant,
    status: Option<Status>,
    traces: Option<StepTraces>,
}

impl VehicleClient {
    /// Connects, waits for a replica that can be used and learns what it serves. A replica whose description is not
    /// valid, or that plans for another vehicle than the gate's, is passed over.
    ///
    /// # Errors
    /// [`ClientError`], above all when no replica gives a usable answer in time.
    pub fn connect(config: &VehicleConfig) -> Result<Self, ClientError> {
        let own = config.driver_of_a_run().map_err(ClientError::Random)?;
        let discovery = Discovery::new(&own)?;
        let open = |path: &PathBuf| {
            let DriverConfig { fleet, vehicle, .. } = &own;
            StepTraces::open(path, config.traces_share, fleet, vehicle)
        };
        let traces = config.traces.as_ref().map(open).transpose()?;
        let (epoch, network) = (Instant::now(), Network::open(config)?);
        let driver = discover(discovery, &network, config, &own)?;
        let status = if config.publish_status {
            let run = getrandom::u64().map_err(ClientError::Random)?;
            Some(Status::new(
                Constants {
                    run,
                    dt: driver.served().dt,
                    deadline: driver.budget(),
                    members: driver.served().members.clone(),
                },
                Instant::now(),
            ))
        } else {
            None
        };
        Ok(Self {
            network,
            driver,
            epoch,
            status,
            traces,
        })
    }

    /// Control period, s.
    pub fn dt(&self) -> f64 {
        self.driver.served().dt
    }

    /// Inputs in a plan, T: the reference has one row more.
    pub fn horizon(&self) -> usize {
        self.driver.served().horizon as usize
    }

    /// Surfaces of the library, in the order of the weights.
    pub fn members(&self) -> &[String] {
        &self.driver.served().members
    }

    /// Weights of the newest reply; empty before the first.
    pub fn weights(&self) -> &[f64] {
        self.driver.weights()
    }

    /// The replicas that have announced themselves until now, also since the last period.
    pub fn replicas(&mut self) -> &[Name] {
        self.tell_what_came(FEW, Instant::now());
        self.driver.replicas()
    }

    /// The mode of the last command.
    pub fn mode(&self) -> Mode {
        self.driver.mode()
    }

    /// Leaves STOP and discards history, weights, plan and outstanding requests, for instance after the vehicle was moved.
    pub fn reset(&mut self) {
        self.driver.reset();
        if let Some(traces) = &mut self.traces {
            traces.abandon();
        }
    }

    /// One control period, to be called once every [`VehicleClient::dt`] with the measured state.
    ///
    /// Returns a command within the budget: from the new plan, from the rest of the last one, or a stop. `reference`
    /// has rows `[p_x, p_y, v_x, psi]` for the stages 0..=T, `widths` as many rows `[left, right]` or none.
    ///
    /// # Errors
    /// [`ClientError::Argument`] if no request can be made from `reference`, `widths` or the road's friction. A measured state
    /// that is not finite, or is outside its domain, is not an error: its command is a stop.
    pub fn step(
        &mut self,
        x: State,
        reference: &[ReferenceRow],
        widths: &[WidthRow],
    ) -> Result<Step, ClientError> {
        self.step_since(Instant::now(), x, reference, widths)
    }

    /// As [`VehicleClient::step`], for a period that began at `start`. The budget starts then, even if the call is
    /// late.
    ///
    /// # Errors
    /// As [`VehicleClient::step`].
    pub fn step_since(
        &mut self,
        start: Instant,
        x: State,
        reference: &[ReferenceRow],
        widths: &[WidthRow],
    ) -> Result<Step, ClientError> {
        let measurement = Measurement {
            x,
            reference: reference.to_vec(),
            widths: widths.to_vec(),
            ..Measurement::default()
        };
        self.step_by(start + self.driver.budget(), measurement)
    }

    /// As [`VehicleClient::step`], with a command due at `deadline` and all that is known about the road.
    ///
    /// # Errors
    /// As [`VehicleClient::step`].
    pub fn step_by(
        &mut self,
        deadline: Instant,
        measurement: Measurement,
    ) -> Result<Step, ClientError> {
        let (began, x) = (Instant::now(), measurement.x);
        let reference = measurement.reference.first().copied();
        let step = self.decide(deadline, measurement)?;
        if let Some(status) = &mut self.status {
            let now = Instant::now();
            let period = Period {
                step: &step,
                x,
                reference,
                weights: self.driver.weights(),
                total: now - began,
            };
            if let Some(message) = status.add(&period, now) {
                self.network.publish(message.encode_to_vec());
            }
        }
        Ok(step)
    }

    fn decide(&mut self, deadline: Instant, measurement: Measurement) -> Result<Step, ClientError> {
        let mut few = FEW.saturating_sub(self.tell_what_came(FEW, deadline));
        let (now, due) = (self.time(Instant::now()), self.time(deadline));
        self.driver.tick(now, due, measurement)?;
        loop {
            while let Some(action) = self.driver.next_action() {
                match action {
                    Action::Command(step) => {
                        if let Some(traces) = &mut self.traces {
                            let epoch = self.epoch;
                            traces.decided(now, epoch.elapsed(), &step, || epoch.elapsed());
                        }
                        return Ok(*step);
                    }
                    // A query that cannot be sent ends at once, and the driver goes on to the next replica.
                    Action::Ask(query) => {
                        if let Some(traces) = &mut self.traces {
                            traces.asked(self.epoch.elapsed(), &query);
                        }
                        self.network.ask(query);
                    }
                    Action::Probe(query) => self.network.ask(query),
                }
            }
            let wake = self.driver.next_wake().unwrap_or(due);
            let left = wake.saturating_sub(self.time(Instant::now()));
            if let Some(event) = self.network.next(left) {
                self.tell(event);
            }
            // The deadline ends the period although events keep coming. After a delay of this program, an answer that came
            // in time may still wait behind a few others.
            if self.time(Instant::now()) >= wake {
                few -= self.tell_what_came(few, Instant::now());
                self.driver.wake(self.time(Instant::now()));
            }
        }
    }

    /// Passes the received events to the driver: the first `few` in any case, further ones until the deadline. Returns their
    /// number. The next step goes on with the rest.
    fn tell_what_came(&mut self, few: usize, deadline: Instant) -> usize {
        let mut told = 0;
        while (told < few || Instant::now() < deadline)
            && let Some(event) = self.network.next(Duration::ZERO)
        {
            self.tell(event);
            told += 1;
        }
        told
    }

    fn tell(&mut self, event: Event) {
        let at = self.time(event.at);
        // This program may have been held up since the event came.
        self.driver.clock(self.time(Instant::now()));
        if let Some(traces) = &mut self.traces {
            match &event.kind {
                EventKind::Replied(id, ..) => traces.replied(at, *id),
                EventKind::Refused(id, error) => traces.refused(at, *id, error),
                EventKind::Ended(id) => traces.ended(at, *id),
                EventKind::Appeared(_) | EventKind::Gone(_) | EventKind::Unknown(_) => {}
            }
        }
        match event.kind {
            EventKind::Appeared(replica) => self.driver.replica_appeared(replica),
            EventKind::Gone(replica) => self.driver.replica_gone(at, &replica),
            EventKind::Unknown(_) => {}
            EventKind::Replied(id, payload, attachment) => {
                self.driver.replied(at, id, &payload, &attachment);
            }
            EventKind::Refused(id, error) => self.driver.refused(at, id, &error),
            EventKind::Ended(id) => self.driver.ended(at, id),
        }
    }

    fn time(&self, at: Instant) -> Time {
        at.saturating_duration_since(self.epoch)
    }
}

/// Asks the live replicas until one answers what it serves, and makes a driver for it.
fn discover(
    mut discovery: Discovery,
    network: &Network,
    config: &VehicleConfig,
    own: &DriverConfig,
) -> Result<Driver, ClientError> {
    let begun = Instant::now();
    loop {
        let left = config.patience.saturating_sub(begun.elapsed());
        if left.is_zero() {
            return Err(ClientError::NoReplica {
                reason: discovery.error(),
                patience: config.patience,
                endpoints: config.connect.clone(),
                unreached: unreached(&config.connect),
            });
        }
        let Some(question) = discovery.next_question() else {
            // Every live replica was asked, or there is none, so wait for a change. All that have come count before the next
            // round, in which each frozen replica takes a second.
            let mut patience = left.min(POLL);
            while let Some(event) = network.next(patience) {
                match event.kind {
                    EventKind::Appeared(replica) => discovery.replica_appeared(replica),
                    EventKind::Gone(replica) => discovery.replica_gone(&replica),
                    _ => {}
                }
                patience = Duration::ZERO;
            }
            continue;
        };
        let read = |answer: &[u8], attachment: &[u8]| {
            discovery.answered(&question.replica, answer, attachment)
        };
        let Some(ready) = network.ask_and_wait(&question, left.min(QUESTION), read)? else {
            continue;
        };
        let mut driver = Driver::new(own.clone(), ready)?;
        for replica in discovery.live() {
            driver.replica_appeared(replica.clone());
        }
        driver.replica_fits(&question.replica);
        return Ok(driver);
    }
}

/// Events that are passed to the driver in each period, even if its deadline has passed, so that they do not pile up.
pub(crate) const FEW: usize = 64;
/// Time between two rounds of questions.
const POLL: Duration = Duration::from_millis(100);
/// Time that a replica may take to answer what it serves.
const QUESTION: Duration = Duration::from_secs(1);

#[cfg(test)]
#[path = "../tests/unit/client.rs"]
mod tests;
