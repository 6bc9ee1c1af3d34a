//! What hostile replicas and planted faults change in messages and commands.

use std::time::Duration;

use egp_driver::Step;
use egp_gate::{Limits, Mode};
use egp_wire::{Code, Reply, WireError};
use rand::RngExt;

use crate::event::Message;
use crate::mutant::Mutant;
use crate::scene::CAR;
use crate::world::World;

impl World<'_> {
    /// Plants a fault into a command. Returns how often the command is given.
    pub(crate) fn spoil(&mut self, v: usize, step: &mut Step) -> u32 {
        let Some(mutant) = self.config.mutant.filter(|_| v == 0) else {
            return 1;
        };
        let late = self.now > Duration::from_secs(1);
        if late {
            self.spoil_limits(v, mutant, &mut step.command.u);
        }
        self.spoil_source(v, mutant, step, late);
        match mutant {
            Mutant::NoCommand if late => 0,
            Mutant::TwoCommands if late => 2,
            _ => 1,
        }
    }

    /// Plants a fault into the values of a command.
    fn spoil_limits(&self, v: usize, mutant: Mutant, u: &mut [f64; 2]) {
        let limits = Limits::of(&CAR.vehicle());
        let [force, rate] = self.vehicles[v].u;
        let [force_step, rate_step] = self.steps();
        match mutant {
            Mutant::Braking => u[0] = 1.01 * limits.force_min,
            Mutant::Driving => u[0] = 1.01 * limits.force_max,
            Mutant::ForceSlew => u[0] = force - 1.5 * force_step,
            Mutant::SteeringRate => u[1] = 1.01 * limits.steering_rate,
            Mutant::SteeringSlew => u[1] = rate - 1.5 * rate_step,
            Mutant::NotFinite => u[1] = f64::NAN,
            Mutant::Power => u[0] = approach(force, limits.force_max, force_step),
            Mutant::SteeringAngle => u[1] = approach(rate, limits.steering_rate, rate_step),
            _ => {}
        }
    }

    /// Plants a fault into the mode of a command, or into what the mode stands for.
    fn spoil_source(&self, v: usize, mutant: Mutant, step: &mut Step, late: bool) {
        let limits = Limits::of(&CAR.vehicle());
        let last = self.vehicles[v].u;
        let [force_step, rate_step] = self.steps();
        let force = |wanted| approach(last[0], wanted, force_step);
        let rate = |wanted| approach(last[1], wanted, rate_step);
        let stopping = -limits.mass * limits.stop_deceleration();
        let command = &mut step.command;
        match (mutant, command.mode) {
            (Mutant::TailAsNormal, Mode::Tail) => command.mode = Mode::Normal,
            (Mutant::TailShifted, Mode::Tail) => (command.u, command.limited) = (last, false),
            (Mutant::TailHeld, Mode::Tail) => (command.u, command.limited) = (last, true),
            (Mutant::HalfForce, Mode::Normal | Mode::Tail) if command.u[0] > 0.0 => {
                command.u[0] *= 0.5;
                command.limited = true;
            }
            (Mutant::HalfSteering, Mode::Normal | Mode::Tail) => {
                command.u[1] *= 0.5;
                command.limited = true;
            }
            (Mutant::SteeringOvershoots, Mode::Normal | Mode::Tail) => {
                command.u[1] = last[1] + rate_step.copysign(command.u[1] - last[1]);
                command.limited = true;
            }
            (Mutant::StopDrives, Mode::Stop) => {
                command.u[0] = last[0].abs().max(1.0);
                command.limited = true;
            }
            (Mutant::StopRepeats, Mode::Stop) => {
                command.u[0] = last[0].abs().max(1.0);
                command.limited = false;
            }
            (Mutant::StopsEarly, Mode::Normal | Mode::Tail) if late => {
                command.mode = Mode::Stop;
                command.u = [force(stopping), rate(0.0)];
            }
            (Mutant::StopEnds, Mode::Stop) => {
                let planned = step.reply.as_ref().and_then(|reply| reply.plan_u.first());
                if let Some(planned) = planned {
                    (command.mode, command.limited) = (Mode::Normal, true);
                    command.u = [force(planned[0]), rate(planned[1])];
                }
            }
            (Mutant::StopCoasts, Mode::Stop) => command.u[0] = force(0.0),
            (Mutant::StopLocks, Mode::Stop) => command.u[0] = force(limits.force_min),
            (Mutant::StopHolds, Mode::Stop) => command.u[0] = force(stopping),
            (Mutant::StopSteers, Mode::Stop) => command.u[1] = rate(limits.steering_rate),
            (Mutant::WaitingDrives, Mode::Waiting) => command.u[0] = force(-stopping),
            _ => {}
        }
    }

    /// The largest change of force, N, and steering rate, rad/s, from one control period to the next.
    fn steps(&self) -> [f64; 2] {
        let limits = Limits::of(&CAR.vehicle());
        [limits.force_slew, limits.steering_slew].map(|slew| slew * self.dt.as_secs_f64())
    }

    /// Plants a fault into an error.
    pub(crate) fn plant_error(&self, message: Message) -> Message {
        match (message, self.config.mutant) {
            (Message::Error(_), Some(Mutant::UntypedError)) => Message::Error(b"\xff".to_vec()),
            (Message::Error(_), Some(Mutant::ErrorWithoutCode)) => {
                Message::Error(WireError::permanent(Code::Unspecified, "planted").encode())
            }
            (message, _) => message,
        }
    }

    /// What a hostile or broken replica sends in place of a reply. Without the keys of vehicles, a reply that is changed and
    /// still valid cannot be told from a true one, and is not sent.
    pub(crate) fn corrupt(&mut self, mut payload: Vec<u8>, old: Option<&Message>) -> Vec<u8> {
        let kinds = if self.config.keys { 6 } else { 4 };
        match (self.rng.random_range(0..kinds), old) {
            (0, _) => payload.truncate(payload.len() / 2),
            (1, _) => payload
                .iter_mut()
                .for_each(|byte| *byte = self.rng.random()),
            (2, Some(Message::Reply(bytes, _))) => payload.clone_from(bytes),
            (4, _) => payload = changed(payload, halve),
            (5, _) => payload = changed(payload, |reply| reply.weights.reverse()),
            _ => payload = vec![0; 2 << 20],
        }
        payload
    }

    /// Plants a fault into a reply.
    pub(crate) fn plant(&mut self, v: usize, payload: Vec<u8>, old: Option<&Message>) -> Vec<u8> {
        let (Some(mutant), 0) = (self.config.mutant, v) else {
            return payload;
        };
        let Ok(mut reply) = Reply::decode(&payload) else {
            return payload;
        };
        let old = match old {
            Some(Message::Reply(bytes, _)) => Reply::decode(bytes).ok(),
            _ => None,
        };
        match mutant {
            Mutant::ChangedWeights => reply.weights.reverse(),
            Mutant::ChangedPlan => halve(&mut reply),
            Mutant::StaleReply => {
                let Some(other) = old.filter(|other| other.plan_x.len() == reply.plan_x.len())
                else {
                    return payload;
                };
                reply.plan_u = other.plan_u;
                reply.weights = other.weights;
            }
            _ => return payload,
        }
        reply.encode()
    }
}

/// `from`, changed towards `to` by at most `step`.
fn approach(from: f64, to: f64, step: f64) -> f64 {
    from + (to - from).clamp(-step, step)
}

/// The bytes of a reply after a change, or the bytes as they were if they are no reply.
fn changed(payload: Vec<u8>, change: impl Fn(&mut Reply)) -> Vec<u8> {
    let Ok(mut reply) = Reply::decode(&payload) else {
        return payload;
    };
    change(&mut reply);
    reply.encode()
}

/// Halves the forces of a plan.
fn halve(reply: &mut Reply) {
    reply.plan_u.iter_mut().for_each(|u| u[0] *= 0.5);
}

/// Microseconds of the real clock, for planted faults.
pub(crate) fn real_micros() -> u64 {
    let elapsed = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    elapsed.map_or(0, |time| u64::from(time.subsec_micros() % 100))
}
