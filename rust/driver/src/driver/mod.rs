//! The state machine: events in, actions out.

mod hedge;
mod open;
mod period;

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use egp_gate::{Gate, Mode};
use egp_wire::keys::Name;
use egp_wire::{Code, MAX_BUDGET_US, Ready, Timing, WireError, limits};
use prost::Message as _;

use crate::action::{Action, QueryId};
use crate::carry::Carry;
use crate::config::{DriverConfig, DriverError};
use crate::measurement::{InvalidArgument, Measurement};
use crate::replicas::Replicas;
use crate::reply;
use crate::situation::{LostDetector, Situation};
#[cfg(doc)]
use crate::step::Step;
use crate::step::{Late, Outcome};
use hedge::HedgeAllowance;
use open::{Pending, Probe, Running};
use period::Answer;

// The gate takes every plan that a message can contain.
const _: () = assert!(egp_gate::MAX_HORIZON == limits::HORIZON);

/// Time since a moment that the transport chooses and then keeps; it must not run backwards.
pub type Time = Duration;

/// The vehicle's side of the control loop; see the crate's documentation for an example.
#[derive(Clone, Debug)]
pub struct Driver {
    config: DriverConfig,
    served: Ready,
    budget: Duration,
    carry: Carry,
    gate: Gate,
    replicas: Replicas,
    hedges: HedgeAllowance,
    lost: LostDetector,
    running: Option<Running>,
    /// When the next tick is expected at the latest; none before the first one and after a reset.
    due: Option<Time>,
    /// The present time that the transport stated last.
    clock: Time,
    /// Control periods in which the caller was held up, until a step reports them.
    held_up: u64,
    pending: BTreeMap<QueryId, Pending>,
    probes: BTreeMap<QueryId, Probe>,
    late: Vec<Late>,
    actions: VecDeque<Action>,
    queries: u64,
}

impl Driver {
    /// A driver for a library that `served` describes, without replicas.
    ///
    /// # Errors
    /// [`DriverError`] when budget, hedge, limits or gate settings are out of range, or when the limits allow more than the
    /// vehicle that the service plans for can do.
    pub fn new(config: DriverConfig, served: Ready) -> Result<Self, DriverError> {
        let gate = config.gate(served.dt)?;
        if let Some(planned) = &served.vehicle {
            config.limits.check_within(planned)?;
        }
        Ok(Self {
            budget: config.budget(served.dt)?,
            hedges: HedgeAllowance::new(config.hedge()?),
            carry: Carry::new(served.library, served.history as usize),
            gate,
            replicas: Replicas::new(config.fleet.clone(), config.vehicle.clone()),
            lost: LostDetector::new(served.vehicle.map_or(1.0, |vehicle| vehicle.scale())),
            running: None,
            due: None,
            clock: Time::ZERO,
            held_up: 0,
            pending: BTreeMap::new(),
            probes: BTreeMap::new(),
            late: Vec::new(),
            actions: VecDeque::new(),
            queries: 0,
            config,
            served,
        })
    }

    /// What the replicas serve.
    pub fn served(&self) -> &Ready {
        &self.served
    }

    /// Time from the start of a period that an answer may take by default. The transport adds it to the start to get the
    /// deadline for [`Self::tick`].
    pub fn budget(&self) -> Duration {
        self.budget
    }

    /// Weights of the newest reply; empty before the first.
    pub fn weights(&self) -> &[f64] {
        self.carry.weights()
    }

    /// Lets the next request start from these weights `[N]`, which are not negative and sum to 1, instead of the last
    /// reply's. The service answers a request with other weights by an error.
    pub fn start_from(&mut self, weights: Vec<f64>) {
        self.carry.start_from(weights);
    }

    /// As [`Self::start_from`], and from now on requests carry no history, so that the service returns the weights as they
    /// are; for a caller that knows the surface and states the weights in each period.
    pub fn hold_weights(&mut self, weights: Vec<f64>) {
        self.carry.hold_weights(weights);
    }

    /// Where the last command came from.
    pub fn mode(&self) -> Mode {
        self.gate.mode()
    }

    /// Leaves STOP and discards history, weights, plan and outstanding requests, for instance after the vehicle was moved.
    pub fn reset(&mut self) {
        self.carry.reset();
        self.gate.reset();
        self.lost.reset();
        self.running = None;
        self.due = None;
        self.held_up = 0;
        self.pending.clear();
        self.late.clear();
        self.discard_actions();
    }

    /// The replicas that announce themselves, in the order of the vehicle's hash.
    pub fn replicas(&self) -> &[Name] {
        self.replicas.live()
    }

    /// A replica announces itself. It is probed, and is asked for steps once it has answered that it serves the vehicle's
    /// library for a vehicle that the gate's limits fit: replies do not show for which vehicle their plans are made.
    pub fn replica_appeared(&mut self, replica: Name) {
        self.replicas.appeared(replica);
    }

    /// The replica that announced itself gave the description with which this driver was made, so that it needs no probe.
    pub fn replica_fits(&mut self, replica: &Name) {
        self.replicas.fits(replica);
    }

    /// A replica withdrew its announcement or was lost. A request that waits for it goes to the next one.
    pub fn replica_gone(&mut self, now: Time, replica: &Name) {
        self.replicas.gone(replica);
        // An answer of the process that has gone says nothing about a later one of the same name.
        self.probes.retain(|_, probe| probe.replica != *replica);
        if let Some(run) = &mut self.running {
            run.remaining.retain(|name| name != replica);
            if run.end(|_, name| name == replica) {
                run.outcome = Outcome::Unreachable;
                run.replica = Some(replica.clone());
                return self.ask_next(now);
            }
        }
        self.after_probe(now);
    }

    /// Opens a control period: the vehicle's state was measured, and a command is due by `deadline`.
    ///
    /// Actions follow until [`Action::Command`], which comes at once when no replica can be asked. A period that is still
    /// open is given up.
    ///
    /// One tick counts as one control period, whatever the time between two ticks is, so that simulators may be slower or
    /// faster than a vehicle. If more whole periods than a plan may bridge (the smaller one of `max_tail_ticks` and the horizon
    /// less 1) pass after the end of a period, they count as driven without commands ([`Step::held_up`]): a plan from before is
    /// not driven any more, and the history starts anew. Shorter delays do not count and do not add up.
    ///
    /// # Errors
    /// [`InvalidArgument`] if no request can be made from the measurement; the period is then not opened, but counts: plans
    /// are a period older, and the history starts anew. A measured state that cannot be used is no error: its command is a
    /// stop, whatever the reference is.
    pub fn tick(
        &mut self,
        now: Time,
        deadline: Time,
        measurement: Measurement,
    ) -> Result<(), InvalidArgument> {
        self.begin(now);
        // The state comes first: a reference that was computed from an unusable state is wrong, too, and must not keep the
        // vehicle from being stopped.
        if let Err(invalid) = measurement.check_state() {
            self.probe(now);
            self.stop_unmeasured(&measurement.x, invalid);
            return Ok(());
        }
        measurement
            .check(self.served.horizon as usize, self.served.dt)
            .inspect_err(|_| {
                self.carry.skip(1);
                self.lost.skip();
            })?;
        self.probe(now);
        let Measurement {
            x,
            reference,
            widths,
            road_friction,
        } = measurement;
        let here = reference.first().copied().unwrap_or_default(); // `check` guarantees a row
        let situation = Situation::new(&x, &here, &self.served.envelope);
        let lost = self.lost.observe(&situation);
        if lost.is_some() {
            self.gate.stop();
        }
        self.due = self.due.max(Some(deadline));
        // If the deadline has passed, no replica is asked and the gate gives the command.
        let left = deadline.saturating_sub(now).as_micros();
        let budget_us = u32::try_from(left).unwrap_or(u32::MAX);
        let budget_us = budget_us.clamp(1, MAX_BUDGET_US);
        let mut request = self.carry.request(x, reference, widths, budget_us);
        request.road_friction = road_friction;
        request.want_sigma = self.config.want_sigma;
        let mut remaining = self.replicas.order();
        remaining.reverse();
        self.running = Some(Running {
            begun: now,
            deadline,
            hedge: self.hedges.open(now, deadline),
            bytes: request.encode(),
            request,
            remaining,
            asked: 0,
            awaited: Vec::new(),
            replica: None,
            outcome: Outcome::Unreachable,
            situation,
            lost,
        });
        self.ask_next(now);
        Ok(())
    }

    /// When [`Driver::wake`] is due; none while no period is open.
    pub fn next_wake(&self) -> Option<Time> {
        let run = self.running.as_ref()?;
        let hedge = run.hedge.filter(|_| !run.remaining.is_empty());
        Some(hedge.unwrap_or(run.deadline))
    }

    /// The next thing to do, oldest first.
    pub fn next_action(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// The time is `now`: a replica that has been silent for long is no longer waited for alone, and past the deadline the
    /// open period is decided without a reply.
    pub fn wake(&mut self, now: Time) {
        let Some(run) = self.running.as_mut() else {
            return;
        };
        if now >= run.deadline {
            self.expire(now);
        } else if !run.remaining.is_empty() && run.hedge.is_some_and(|at| now >= at) {
            run.hedge = None;
            self.hedges.spend();
            self.ask_next(now);
        }
    }

    /// A replica replied with these bytes and this attachment. With a key, a reply without the tag of the answer has no
    /// effect but on the outcome that is reported when no other answer comes.
    pub fn replied(&mut self, now: Time, id: QueryId, payload: &[u8], attachment: &[u8]) {
        if let Some(probe) = self.probes.get(&id) {
            if self
                .config
                .authentic(probe.tag.as_ref(), payload, attachment)
            {
                self.probed(now, id, payload);
            }
            return;
        }
        if let Some(pending) = self.pending.get_mut(&id)
            && !self
                .config
                .authentic(pending.tag.as_ref(), payload, attachment)
        {
            // The replica's own answer may still come.
            pending.forged = true;
            return;
        }
        let Some(pending) = self.pending.remove(&id) else {
            return; // from before a reset, or a second reply to one query
        };
        let reply = match reply::decode(payload, &pending.request, &self.served) {
            Ok(reply) => reply,
            Err(invalid) => {
                self.demote(now, &pending);
                return self.failed(now, id, &pending.replica, Outcome::Unusable(invalid));
            }
        };
        self.replicas.answered(&pending.replica, now);
        if pending.decided_without {
            if now >= pending.due {
                // The replica missed its deadline, although another one's answer had decided the period.
                self.demote(now, &pending);
            }
            return;
        }
        self.accept(&reply);
        let current =
            |run: &&mut Running| run.request.sequence == reply.sequence && now <= run.deadline;
        match self.running.as_mut().filter(current) {
            Some(run) => {
                run.outcome = Outcome::Replied(reply.status);
                run.end(|awaited, _| awaited == id);
                run.replica = Some(pending.replica);
                let timing = Timing::decode(attachment).ok();
                let answer = Answer {
                    reply,
                    bytes: payload.to_vec(),
                    timing: timing.filter(|_| !attachment.is_empty()),
                };
                self.decide(now, Some(answer));
            }
            None => self.late.push(Late {
                latency: now.saturating_sub(pending.sent),
                reply_bytes: payload.to_vec(),
            }),
        }
    }

    /// A replica answered with an error, given as the bytes of an `egp.v1.Error`. Bytes that are no such
    /// message count as [`Driver::ended`]. With a key, a reply to the same query is still used, because errors have no tag.
    ///
    /// With two routers a replica may receive a question twice and reject the second copy. Errors of this kind
    /// ([`Code::Superseded`]; with a key also [`Code::Unauthenticated`]) take effect only when the query ends without a reply.
    pub fn refused(&mut self, now: Time, id: QueryId, error: &[u8]) {
        let Some(mut pending) = self.pending.remove(&id) else {
            return self.probe_ended(now, id);
        };
        let error = WireError::decode(error);
        let sealed = pending.tag.is_some();
        let copied = |error: &WireError| {
            error.code == Code::Superseded || (sealed && error.code == Code::Unauthenticated)
        };
        if let Some(error) = error.as_ref().ok().filter(|error| copied(error)) {
            pending.refusal = Some(error.clone());
            self.pending.insert(id, pending);
            return;
        }
        if sealed {
            let counted = true; // the end of the query follows, and is no further failure
            let kept = Pending {
                counted,
                ..pending.clone()
            };
            self.pending.insert(id, kept);
        }
        match error {
            Ok(error) => self.reject(now, id, &pending, error),
            Err(_) => self.vanished(now, id, &pending),
        }
    }

    /// A query ended without an answer: the replica is not there, or the network does not let the query through.
    pub fn ended(&mut self, now: Time, id: QueryId) {
        self.probe_ended(now, id);
        if let Some(mut pending) = self.pending.remove(&id) {
            match pending.refusal.take() {
                Some(error) => self.reject(now, id, &pending, error),
                None => self.vanished(now, id, &pending),
            }
        }
    }
}
