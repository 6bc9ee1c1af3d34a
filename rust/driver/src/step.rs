//! The result of one control period.

use std::time::Duration;

use egp_gate::Command;
use egp_wire::keys::Name;
use egp_wire::{Invalid, Reply, Status, Timing, WireError, status_name};

use crate::situation::{Lost, Situation};

/// One control period.
#[derive(Clone, Debug)]
pub struct Step {
    /// What goes to the actuators.
    pub command: Command,
    /// Outcome of the request.
    pub outcome: Outcome,
    /// The replica that the outcome is about; `None` if no replica was asked.
    pub replica: Option<Name>,
    /// Bytes of the request; empty when none could be made.
    pub request: Vec<u8>,
    /// The reply to this period's request, when a usable one came in time.
    pub reply: Option<Reply>,
    /// Bytes of that reply; empty without one.
    pub reply_bytes: Vec<u8>,
    /// From the start of the period to the answer, when one came in time; zero where the answer is computed in the same
    /// process.
    pub latency: Option<Duration>,
    /// Where the service spent its time, when the reply says so.
    pub timing: Option<Timing>,
    /// Usable replies to earlier requests that have come since the last step.
    pub late: Vec<Late>,
    /// Number of replicas that were asked.
    pub asked: u32,
    /// Where the vehicle is relative to the library's training data and to the reference; `None` if the measurement is
    /// not usable.
    pub situation: Option<Situation>,
    /// Why the vehicle counts as lost and is therefore stopped, until the driver is reset; none while it does not.
    pub lost: Option<Lost>,
    /// Control periods by the clock in which the caller was held up before or in this step, when they are more than a plan
    /// may bridge; 0 otherwise. Plans have aged by them, and the history starts anew.
    pub held_up: u64,
}

/// A usable reply that came after its deadline.
#[derive(Clone, Debug, PartialEq)]
pub struct Late {
    /// From sending the request to the reply.
    pub latency: Duration,
    /// The reply as sent.
    pub reply_bytes: Vec<u8>,
}

/// Outcome of a request.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// A usable reply came in time; it holds a plan exactly if the status is solved.
    Replied(Status),
    /// The last replica that was asked answered with this error.
    Refused(WireError),
    /// The last replica that was asked sent a reply that cannot be used, for this reason.
    Unusable(Invalid),
    /// The deadline passed while a replica was silent, or before any could be asked.
    Late,
    /// No replica is alive, or none that was asked was still there.
    Unreachable,
    /// The measured state is not finite or not that of a road vehicle, so no request was made.
    InvalidState(Invalid),
}

impl Outcome {
    /// Whether a new plan came in time.
    pub fn is_solved(&self) -> bool {
        *self == Self::Replied(Status::Solved)
    }

    /// The outcome in one word: the solver's status (`solved`, `iteration_limit`, `infeasible`, `numerical_error`,
    /// `check_failed`) or `refused`, `unusable`, `late`, `unreachable`, `invalid_state`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Replied(status) => status_name(*status),
            Self::Refused(_) => "refused",
            Self::Unusable(_) => "unusable",
            Self::Late => "late",
            Self::Unreachable => "unreachable",
            Self::InvalidState(_) => "invalid_state",
        }
    }

    /// Why there is no plan, in words; empty when there is one.
    pub fn detail(&self) -> String {
        match self {
            Self::Replied(Status::Solved) => String::new(),
            Self::Replied(Status::CheckFailed) => "the solver found no plan that passes its check (check_failed); likely \
                 causes are a setting that differs from its default by orders of magnitude, usually a weight or a penalty, \
                 and a vehicle that spins, whose plan has speeds that no vehicle reaches"
                .to_owned(),
            Self::Replied(status) => {
                format!("the solver found no plan: {}", status_name(*status))
            }
            Self::Refused(error) => format!("{}: {error}", error.code_name()),
            Self::Unusable(invalid) => format!("the reply cannot be used: {invalid}"),
            Self::Late => "no answer came before the deadline".to_owned(),
            Self::Unreachable => "no replica of the service can be reached that fits: none announces itself, or those that do \
                shut down, serve another library or vehicle or have another horizon, or access control does not admit this \
                vehicle's certificate"
                .to_owned(),
            Self::InvalidState(invalid) => invalid.to_string(),
        }
    }
}
