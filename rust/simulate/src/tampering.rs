//! What hostile replicas and planted faults change in messages and commands.

use std::time::Duration;

use egp_driver::Step;
use egp_wire::{Code, MessageLimits, Reply, WireError};
use rand::RngExt;

use crate::event::Message;
use crate::mutant::Mutant;
use crate::world::World;

impl World<'_> {
    /// Plants a fault into a command. Returns how often the command is given.
    pub(crate) fn spoil(&mut self, v: usize, step: &mut Step) -> u32 {
        use egp_gate::Mode;
        let Some(mutant) = self.config.mutant.filter(|_| v == 0) else {
            return 1;
        };
        let limits = egp_gate::Limits::of(&crate::scene::CAR.vehicle());
        let late = self.now > Duration::from_secs(1);
        let command = &mut step.command;
        match mutant {
            Mutant::NoCommand if late => return 0,
            Mutant::TwoCommands if late => return 2,
            Mutant::Braking if late => command.u[0] = 1.01 * limits.force_min,
            Mutant::Driving if late => command.u[0] = 1.01 * limits.force_max,
            Mutant::ForceSlew if late => {
                let step = 1.5 * limits.force_slew * self.dt.as_secs_f64();
                command.u[0] = self.vehicles[v].u[0] - step;
            }
            Mutant::SteeringRate if late => command.u[1] = 1.01 * limits.steering_rate,
            Mutant::SteeringSlew if late => {
                let step = 1.5 * limits.steering_slew * self.dt.as_secs_f64();
                command.u[1] = self.vehicles[v].u[1] - step;
            }
            Mutant::NotFinite if late => command.u[1] = f64::NAN,
            Mutant::TailAsNormal if command.mode == Mode::Tail => command.mode = Mode::Normal,
            Mutant::TailShifted if command.mode == Mode::Tail => {
                command.u = self.vehicles[v].u;
                command.limited = false;
            }
            Mutant::TailHeld if command.mode == Mode::Tail => {
                command.u = self.vehicles[v].u;
                command.limited = true;
            }
            Mutant::StopDrives if command.mode == Mode::Stop => {
                command.u[0] = self.vehicles[v].u[0].abs().max(1.0);
                command.limited = true;
            }
            Mutant::StopRepeats if command.mode == Mode::Stop => {
                command.u[0] = self.vehicles[v].u[0].abs().max(1.0);
                command.limited = false;
            }
            _ => {}
        }
        1
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
        let limits = MessageLimits::default();
        let Ok(mut reply) = Reply::decode(&payload, &limits) else {
            return payload;
        };
        let old = match old {
            Some(Message::Reply(bytes, _)) => Reply::decode(bytes, &limits).ok(),
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

/// The bytes of a reply after a change, or the bytes as they were if they are no reply.
fn changed(payload: Vec<u8>, change: impl Fn(&mut Reply)) -> Vec<u8> {
    let Ok(mut reply) = Reply::decode(&payload, &MessageLimits::default()) else {
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
