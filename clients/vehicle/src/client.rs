//! The client of one vehicle.

use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant};

use egp_gate::{Gate, GateError, Mode};
use egp_wire::keys::{self, Name};
use egp_wire::{Carry, Invalid, Limits, Ready, ReferenceRow, Reply, State, WidthRow};
use thiserror::Error;

use crate::config::VehicleConfig;
use crate::network::{Answer, Arrival, Network, NetworkError};
use crate::replicas::Preference;
use crate::step::{Outcome, Step};

/// Why a client could not connect, or a step not begin.
#[derive(Debug, Error)]
pub enum ClientError {
    /// zenoh refused something.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// No replica, or none that answers.
    #[error(
        "no replica answered within {patience:?} at {endpoints:?}; is the service running there?"
    )]
    NoReplica {
        /// How long the client waited.
        patience: Duration,
        /// Where it connected to.
        endpoints: Vec<String>,
    },
    /// What the replica says of itself cannot be read.
    #[error("replica {replica} describes itself wrongly: {source}")]
    Description {
        /// The replica.
        replica: Name,
        /// What is wrong.
        source: Invalid,
    },
    /// The gate refused its configuration.
    #[error(transparent)]
    Gate(#[from] GateError),
    /// The measured state or the reference is refused.
    #[error(transparent)]
    Measurement(#[from] Invalid),
    /// The budget is out of range.
    #[error("the budget must be in (0, 1] of the control period, got {0}")]
    Budget(f64),
}

/// A request whose answer is outstanding.
struct Pending {
    sent: Instant,
    arrivals: Receiver<Arrival>,
}

/// What an exchange brought in time.
struct Exchange {
    outcome: Outcome,
    reply: Option<Reply>,
    arrived: Option<(Duration, Answer)>,
    asked: u32,
}

/// Carry, gate and network of one vehicle.
pub struct VehicleClient {
    network: Network,
    preference: Preference,
    fleet: Name,
    vehicle: Name,
    carry: Carry,
    gate: Gate,
    served: Ready,
    budget: Duration,
    pending: Vec<Pending>,
}

impl VehicleClient {
    /// Connects, waits for a replica and learns what it serves.
    ///
    /// # Errors
    /// [`ClientError`], above all when no replica answers in time.
    pub fn connect(config: &VehicleConfig) -> Result<Self, ClientError> {
        if !(config.budget > 0.0 && config.budget <= 1.0) {
            return Err(ClientError::Budget(config.budget));
        }
        let network = Network::open(config)?;
        let mut preference = Preference::new(config.fleet.clone(), config.vehicle.clone());
        let served = learn(&network, &mut preference, config)?;
        let tail = config.max_tail_ticks;
        Ok(Self {
            gate: Gate::new(config.limits, served.dt, tail, config.stop_deceleration)?,
            carry: Carry::new(served.library, served.history as usize),
            budget: Duration::from_secs_f64(served.dt * config.budget),
            network,
            preference,
            fleet: config.fleet.clone(),
            vehicle: config.vehicle.clone(),
            served,
            pending: Vec::new(),
        })
    }

    /// Control period, s.
    pub fn dt(&self) -> f64 {
        self.served.dt
    }

    /// Inputs in a plan, T: the reference has one row more.
    pub fn horizon(&self) -> usize {
        self.served.horizon as usize
    }

    /// Surfaces of the library, in the order of the weights.
    pub fn members(&self) -> &[String] {
        &self.served.members
    }

    /// Weights of the newest reply; empty before the first.
    pub fn weights(&self) -> &[f64] {
        self.carry.weights()
    }

    /// Where the last command came from.
    pub fn mode(&self) -> Mode {
        self.gate.mode()
    }

    /// Leaves STOP and forgets the past, for instance after the vehicle was moved.
    pub fn reset(&mut self) {
        self.carry.reset();
        self.gate.reset();
        self.pending.clear();
    }

    /// One control period, to be called once every [`VehicleClient::dt`] with the measured state.
    ///
    /// Returns within the budget, with a command in any case: from the new plan, from the rest of the last
    /// one, or a stop. `reference` has `[p_x, p_y, v_x, psi]` for the stages 0..=T, `widths` as many rows
    /// `[left, right]` or none.
    ///
    /// # Errors
    /// [`ClientError::Measurement`] when `x`, `reference` or `widths` cannot be meant; use
    /// [`VehicleClient::stop`] for the command then.
    pub fn step(
        &mut self,
        x: State,
        reference: &[ReferenceRow],
        widths: &[WidthRow],
    ) -> Result<Step, ClientError> {
        self.step_since(Instant::now(), x, reference, widths)
    }

    /// As [`VehicleClient::step`], for a period that began at `start`: budget and latency count from there,
    /// however late the call is.
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
        let late = self.collect_late();
        let left = (start + self.budget).saturating_duration_since(Instant::now());
        // With nothing left the service refuses, which is what a period that began late deserves.
        let budget_us = u32::try_from(left.as_micros()).unwrap_or(u32::MAX).max(1);
        let request = self
            .carry
            .request(x, reference.to_vec(), widths.to_vec(), budget_us);
        request.validate(&Limits::default())?;
        let exchange = self.exchange(&request.encode(), start)?;
        if let Some(reply) = &exchange.reply {
            self.take(reply);
        }
        let tick = self.carry.sequence();
        let [_, _, v_x, _, _, _, delta] = x;
        let command = self.gate.command(tick, v_x, delta);
        self.carry.applied(command.u);
        let (latency, timing) = match exchange.arrived {
            Some((latency, answer)) => (Some(latency), answer.timing),
            None => (None, None),
        };
        let Exchange {
            outcome,
            reply,
            asked,
            ..
        } = exchange;
        Ok(Step {
            command,
            outcome,
            reply,
            latency,
            timing,
            late,
            asked,
        })
    }

    /// The command of a period in which no request could be made: the measurement is not to be trusted.
    pub fn stop(&mut self) -> egp_gate::Command {
        let tick = self.carry.sequence();
        let command = self.gate.command(tick, f64::NAN, f64::NAN);
        self.carry.applied(command.u);
        command
    }

    /// Asks replica after replica until one replies, time runs out, or none is left.
    fn exchange(&mut self, request: &[u8], sent: Instant) -> Result<Exchange, ClientError> {
        let deadline = sent + self.budget;
        let mut exchange = Exchange {
            outcome: Outcome::Unreachable,
            reply: None,
            arrived: None,
            asked: 0,
        };
        for replica in self.preference.order(self.network.replicas(), sent) {
            let key = keys::step(&replica, &self.fleet, &self.vehicle);
            // Longer than anybody waits, so that a late answer is still seen.
            let arrivals = self.network.ask(&key, request.to_vec(), self.budget * 20)?;
            exchange.asked += 1;
            let remaining = deadline.saturating_duration_since(Instant::now());
            match arrivals.recv_timeout(remaining) {
                Ok(Arrival {
                    at,
                    content: Ok(answer),
                }) => {
                    match Reply::decode(&answer.payload, &Limits::default()) {
                        Ok(reply) => {
                            exchange.outcome = Outcome::Replied(reply.status);
                            exchange.reply = Some(reply);
                        }
                        Err(invalid) => exchange.outcome = Outcome::Refused(invalid.into()),
                    }
                    exchange.arrived = Some((at - sent, answer));
                    break;
                }
                Ok(Arrival {
                    content: Err(error),
                    ..
                }) => {
                    let next = error.retryable;
                    exchange.outcome = Outcome::Refused(error);
                    if !next {
                        break;
                    }
                }
                // Nobody there any more.
                Err(RecvTimeoutError::Disconnected) => {}
                Err(RecvTimeoutError::Timeout) => {
                    self.preference.distrust(replica, sent);
                    self.pending.push(Pending { sent, arrivals });
                    exchange.outcome = Outcome::Late;
                    break;
                }
            }
        }
        Ok(exchange)
    }

    /// Takes the earlier answers that have come since; their plans may still have inputs for now.
    fn collect_late(&mut self) -> Vec<Duration> {
        let mut latencies = Vec::new();
        for pending in std::mem::take(&mut self.pending) {
            match pending.arrivals.try_recv() {
                Ok(Arrival { at, content }) => {
                    latencies.push(at - pending.sent);
                    let reply = content
                        .ok()
                        .map(|answer| Reply::decode(&answer.payload, &Limits::default()));
                    if let Some(Ok(reply)) = reply {
                        self.take(&reply);
                    }
                }
                Err(TryRecvError::Empty) => self.pending.push(pending),
                Err(TryRecvError::Disconnected) => {}
            }
        }
        latencies
    }

    /// Hands a reply to carry and gate, which ignore what is older than what they have.
    fn take(&mut self, reply: &Reply) {
        if self.carry.accept(reply) == Ok(true) && !reply.plan_u.is_empty() {
            // A gate in STOP takes no plan; that is its purpose, and its command says so.
            let _ = self.gate.accept(reply.sequence, &reply.plan_u);
        }
    }
}

/// What the first replica that answers serves.
fn learn(
    network: &Network,
    preference: &mut Preference,
    config: &VehicleConfig,
) -> Result<Ready, ClientError> {
    let deadline = Instant::now() + config.patience;
    loop {
        let remaining = deadline.saturating_duration_since(Instant::now());
        if !network.wait_for_replica(remaining) || remaining.is_zero() {
            return Err(ClientError::NoReplica {
                patience: config.patience,
                endpoints: config.connect.clone(),
            });
        }
        for replica in preference.order(network.replicas(), Instant::now()) {
            let arrivals = network.ask(&keys::ready(&replica), vec![], remaining)?;
            let Ok(Arrival {
                content: Ok(answer),
                ..
            }) = arrivals.recv()
            else {
                continue;
            };
            return Ready::decode(&answer.payload, &Limits::default())
                .map_err(|source| ClientError::Description { replica, source });
        }
    }
}
