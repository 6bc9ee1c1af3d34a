//! How a control period gets from its request to its command.

use std::time::Duration;

use egp_gate::Command;
use egp_wire::keys::{self, Name};
use egp_wire::{Code, Invalid, Ready, Reply, State, Timing, WireError};

use super::{Driver, Pending, Probe, Time};
use crate::action::{Action, Query, QueryId};
use crate::situation::Lost;
use crate::step::{Outcome, Step};

/// Time, in control periods, for which a transport waits for an answer. A plan that arrives later has few inputs left, or
/// none.
const LISTEN_PERIODS: u32 = 20;
/// Requests whose late answers are still awaited, at most.
const MAX_PENDING: usize = 64;

/// A usable reply in time.
pub(super) struct Answer {
    pub(super) reply: Reply,
    pub(super) bytes: Vec<u8>,
    pub(super) timing: Option<Timing>,
}

impl Driver {
    /// The present time is `now`. A transport says so before it reports an event that came some time ago: if the program
    /// was held up in between, the periods that have passed count before the gate gives the command.
    pub fn clock(&mut self, now: Time) {
        self.clock = now;
    }

    /// Counts a control period that cannot be opened, because the transport has no measurement with a usable form: plans are
    /// a period older, and the history starts anew, as after an error of [`Driver::tick`].
    pub fn skip_period(&mut self, now: Time) {
        self.begin(now);
        self.carry.skip(1);
    }

    /// Gives an open period up, because the transport's step has ended without its command. What was to be done for it is
    /// not done, and the history starts anew, because it is not known how long the last input was applied.
    pub fn abandon(&mut self) {
        self.running = None;
        self.discard_actions();
        self.carry.forget_running();
    }

    /// Ends the period before, if it is still open, and counts the periods in which the caller was held up.
    pub(super) fn begin(&mut self, now: Time) {
        self.give_up(now);
        self.count_held_up(now);
        self.due = Some(now.saturating_add(self.period()));
    }

    /// Asks the next replica for the open period's step. Decides the period when no time is left, or when there is neither
    /// a further replica nor an answer to wait for, not even that of a replica that may turn out to fit.
    pub(super) fn ask_next(&mut self, now: Time) {
        let listen = self.period() * LISTEN_PERIODS;
        let Some(run) = self.running.as_mut() else {
            return;
        };
        let next = if now < run.deadline {
            run.remaining.pop()
        } else {
            None
        };
        let Some(replica) = next else {
            if now >= run.deadline {
                self.expire(now);
            } else if run.awaited.is_empty() && !self.awaits_description() {
                self.decide(now, None);
            }
            return;
        };
        run.asked += 1;
        self.queries += 1;
        let id = QueryId(self.queries);
        let key = keys::step(&replica, &self.config.fleet, &self.config.vehicle);
        let (attachment, tag) = self.config.seal(&key, id.0, &run.bytes);
        let query = Query {
            id,
            key,
            payload: run.bytes.clone(),
            attachment,
            listen: run.deadline.saturating_sub(now).saturating_add(listen),
            replica: replica.clone(),
        };
        let pending = Pending {
            replica: replica.clone(),
            sent: now,
            due: run.deadline,
            request: run.request.clone(),
            tag,
            forged: false,
            counted: false,
            decided_without: false,
            refusal: None,
        };
        run.awaited.push((id, replica.clone()));
        run.replica = Some(replica);
        self.pending.insert(id, pending);
        if self.pending.len() > MAX_PENDING {
            self.pending.pop_first();
        }
        self.actions.push_back(Action::Ask(query));
    }

    /// Notes the end of a query; if the open period waited for it, asks the next replica.
    pub(super) fn failed(&mut self, now: Time, id: QueryId, replica: &Name, outcome: Outcome) {
        if let Some(run) = &mut self.running
            && run.end(|awaited, _| awaited == id)
        {
            run.outcome = outcome;
            run.replica = Some(replica.clone());
            self.ask_next(now);
        }
    }

    /// Decides the open period, whose deadline has passed.
    pub(super) fn expire(&mut self, now: Time) {
        let undescribed = self.awaits_description();
        // There may have been no time left to ask anyone.
        if let Some(run) = &mut self.running
            && (undescribed
                || !run.awaited.is_empty()
                || (run.asked == 0 && !run.remaining.is_empty()))
        {
            run.outcome = Outcome::Late;
            for (id, replica) in &run.awaited {
                run.replica = Some(replica.clone());
                self.replicas.demote(replica, now);
                if let Some(pending) = self.pending.get_mut(id) {
                    pending.counted = true;
                }
            }
        }
        self.decide(now, None);
    }

    /// Demotes the replicas that have let a deadline pass while another one's answer decided the period.
    fn count_overdue(&mut self, now: Time) {
        let overdue = |pending: &&mut Pending| {
            pending.decided_without && !pending.counted && now >= pending.due
        };
        for pending in self.pending.values_mut().filter(overdue) {
            pending.counted = true;
            self.replicas.demote(&pending.replica, now);
        }
    }

    /// Counts the failure of a query against its replica, unless the deadline that passed was counted already.
    pub(super) fn demote(&mut self, now: Time, pending: &Pending) {
        if !pending.counted {
            self.replicas.demote(&pending.replica, now);
        }
    }

    /// A replica answered with an error.
    pub(super) fn reject(&mut self, now: Time, id: QueryId, pending: &Pending, error: WireError) {
        // These errors do not demote a replica: it is overloaded, drains, or has received a newer request, or the request
        // itself has a value that no replica accepts.
        let blameless = matches!(
            error.code,
            Code::Overloaded
                | Code::TooLate
                | Code::Draining
                | Code::Superseded
                | Code::InvalidField
        );
        if !blameless {
            self.demote(now, pending);
        }
        self.failed(now, id, &pending.replica, Outcome::Refused(error));
    }

    /// A replica that announces itself gave no answer at all.
    pub(super) fn vanished(&mut self, now: Time, id: QueryId, pending: &Pending) {
        self.demote(now, pending);
        let outcome = if pending.forged {
            let reason = "the answer does not have the tag of this vehicle's key: it does not come from a service that has the key";
            Outcome::Unusable(Invalid::field("tag", reason))
        } else {
            Outcome::Unreachable
        };
        self.failed(now, id, &pending.replica, outcome);
    }

    /// Decides the open period and gives its command.
    pub(super) fn decide(&mut self, now: Time, answer: Option<Answer>) {
        let Some(run) = self.running.take() else {
            return;
        };
        let present = now.max(self.clock);
        let counted = self.count_held_up(present);
        // If the delay is not counted, the next period is due after this one's deadline.
        let end = if counted {
            present
        } else {
            now.min(run.deadline)
        };
        self.due = Some(end.max(run.begun.saturating_add(self.period())));
        if answer.is_some() {
            for (id, _) in &run.awaited {
                if let Some(pending) = self.pending.get_mut(id) {
                    pending.decided_without = true;
                }
            }
        }
        let [_, _, v_x, _, _, _, delta] = run.request.x;
        let command = self.gate.command(self.carry.sequence(), v_x, delta);
        self.carry.applied(command.u);
        let latency = answer.is_some().then(|| now.saturating_sub(run.begun));
        let (reply, reply_bytes, timing) = match answer {
            Some(answer) => (Some(answer.reply), answer.bytes, answer.timing),
            None => (None, Vec::new(), None),
        };
        let step = Step {
            replica: run.replica,
            request: run.bytes,
            reply,
            reply_bytes,
            latency,
            timing,
            asked: run.asked,
            situation: Some(run.situation),
            ..self.step_without_request(command, run.outcome, run.lost)
        };
        self.actions.push_back(Action::Command(Box::new(step)));
    }

    /// The command of a period whose measured state cannot be used: a stop. The gate gets the speed and the steering angle if
    /// they themselves are inside the domain of the messages, so that its force opposes the motion of a vehicle that rolls
    /// back.
    pub(super) fn stop_unmeasured(&mut self, x: &State, invalid: Invalid) {
        self.carry.skip(1);
        self.gate.stop();
        let [_, _, v_x, _, _, _, delta] = *x;
        let usable =
            |state: State, value: f64| egp_wire::check_state(&state).map_or(f64::NAN, |()| value);
        let v_x = usable([0.0, 0.0, v_x, 0.0, 0.0, 0.0, 0.0], v_x);
        let delta = usable([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, delta], delta);
        let command = self.gate.command(self.carry.sequence(), v_x, delta);
        self.carry.applied(command.u);
        let outcome = Outcome::InvalidState(invalid);
        let step = self.step_without_request(command, outcome, self.lost.lost());
        self.actions.push_back(Action::Command(Box::new(step)));
    }

    /// A step without a request, which reports the late replies and the held-up periods since the last step.
    fn step_without_request(
        &mut self,
        command: Command,
        outcome: Outcome,
        lost: Option<Lost>,
    ) -> Step {
        Step {
            command,
            outcome,
            replica: None,
            request: Vec::new(),
            reply: None,
            reply_bytes: Vec::new(),
            latency: None,
            timing: None,
            late: std::mem::take(&mut self.late),
            asked: 0,
            situation: None,
            lost,
            held_up: std::mem::take(&mut self.held_up),
        }
    }

    /// Hands a usable reply to carry and gate, which ignore what is older than what they hold.
    pub(super) fn accept(&mut self, reply: &Reply) {
        if self.carry.accept(reply) && !reply.plan_u.is_empty() {
            // A gate in STOP takes no plan; its command says so.
            let _ = self.gate.accept(reply.sequence, &reply.plan_u);
        }
    }

    /// Counts the whole control periods that have passed since the next tick was due, if they are more than a plan may bridge:
    /// more than the tail may last, or than the plan has inputs after its first one. Returns whether that was so.
    pub(super) fn count_held_up(&mut self, now: Time) -> bool {
        let late = self.due.map_or(Time::ZERO, |due| now.saturating_sub(due));
        let periods = late.as_nanos() / self.period().as_nanos().max(1);
        let periods = u64::from(u32::try_from(periods).unwrap_or(u32::MAX));
        let inputs = u64::from(self.served.horizon);
        let tail = self.config.tail_ticks(self.served.dt);
        let counts = periods > tail.min(inputs.saturating_sub(1));
        if counts {
            self.carry.skip(periods);
            self.held_up += periods;
        }
        counts
    }

    /// Discards the actions of a period that is over. Probes belong to no period.
    pub(super) fn discard_actions(&mut self) {
        self.actions
            .retain(|action| matches!(action, Action::Probe(_)));
    }

    /// Gives an open period up without a command, demotes the replicas that have let a deadline pass, and removes
    /// requests and probes whose answers are no longer listened for.
    pub(super) fn give_up(&mut self, now: Time) {
        self.running = None;
        self.discard_actions();
        self.count_overdue(now);
        let listen = self.period() * LISTEN_PERIODS;
        self.pending
            .retain(|_, pending| now.saturating_sub(pending.due) <= listen);
        self.probes
            .retain(|_, probe| now.saturating_sub(probe.sent) <= listen);
    }

    /// Probes a replica when one is due.
    pub(super) fn probe(&mut self, now: Time) {
        let Some(replica) = self.replicas.next_probe(now) else {
            return;
        };
        self.queries += 1;
        let id = QueryId(self.queries);
        let key = keys::ready(&replica);
        let (attachment, tag) = self.config.seal(&key, id.0, &[]);
        let probe = Probe {
            replica: replica.clone(),
            sent: now,
            tag,
        };
        self.probes.insert(id, probe);
        self.actions.push_back(Action::Probe(Query {
            id,
            key,
            payload: Vec::new(),
            attachment,
            listen: self.period() * LISTEN_PERIODS,
            replica,
        }));
    }

    /// A probe was answered: a replica that is ready and serves the vehicle's library for a vehicle that the gate's limits
    /// fit may be asked, at the end of the open period, too. If it answered within a period, it is promoted.
    pub(super) fn probed(&mut self, now: Time, id: QueryId, answer: &[u8]) {
        let Some(Probe { replica, sent, .. }) = self.probes.remove(&id) else {
            return;
        };
        let ready = Ready::decode(answer).ok();
        if ready.is_some_and(|ready| self.suits(&ready)) {
            if now.saturating_sub(sent) <= self.period() {
                self.replicas.probe_answered(&replica, sent);
            }
            if self.replicas.fits(&replica)
                && let Some(run) = &mut self.running
            {
                run.remaining.insert(0, replica);
            }
        }
        self.after_probe(now);
    }

    /// A probe ended without an answer.
    pub(super) fn probe_ended(&mut self, now: Time, id: QueryId) {
        if self.probes.remove(&id).is_some() {
            self.after_probe(now);
        }
    }

    /// Goes on with an open period that may have waited for a replica's description only.
    pub(super) fn after_probe(&mut self, now: Time) {
        if (self.running.as_ref()).is_some_and(|run| run.awaited.is_empty()) {
            self.ask_next(now);
        }
    }

    /// Whether a replica with this description can be asked for steps. The vehicle in a description belongs to the library
    /// that `ready.library` names, and so do horizon and history. If the library that is used is another one, they are not
    /// compared.
    fn suits(&self, ready: &Ready) -> bool {
        let (served, limits) = (&self.served, &self.config.limits);
        let vehicle_fits = |ready: &Ready| {
            (ready.vehicle.as_ref()).is_none_or(|planned| limits.check_within(planned).is_ok())
        };
        let lengths = ready.horizon == served.horizon && ready.history >= served.history;
        ready.ready
            && !self.config.lacks_key(ready)
            && ready.serves(&served.library)
            && (ready.library != served.library || lengths && vehicle_fits(ready))
    }

    /// Whether a live replica that is not known to fit may still answer its probe.
    fn awaits_description(&self) -> bool {
        let mut probes = self.probes.values();
        probes.any(|probe| self.replicas.is_unchecked(&probe.replica))
    }

    pub(super) fn period(&self) -> Duration {
        Duration::from_secs_f64(self.served.dt)
    }
}
