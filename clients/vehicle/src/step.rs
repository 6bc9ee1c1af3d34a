//! What one control period brought.

use std::time::Duration;

use egp_gate::Command;
use egp_wire::{Reply, Status, Timing, WireError};

/// One control period.
#[derive(Clone, Debug)]
pub struct Step {
    /// What goes to the actuators.
    pub command: Command,
    /// What became of the request.
    pub outcome: Outcome,
    /// The reply, when one came in time.
    pub reply: Option<Reply>,
    /// From sending to the answer, when one came in time.
    pub latency: Option<Duration>,
    /// Where the service spent its time.
    pub timing: Option<Timing>,
    /// Latencies of earlier requests whose answers have come since the last step.
    pub late: Vec<Duration>,
    /// Replicas that were asked.
    pub asked: u32,
}

/// What became of a request.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// A reply in time, with a plan exactly if the status is solved.
    Replied(Status),
    /// Every replica that was asked refused; the last one's reason.
    Refused(WireError),
    /// The deadline passed.
    Late,
    /// No replica is alive, or none that was asked was still there.
    Unreachable,
}

impl Outcome {
    /// Whether a new plan came in time.
    pub fn is_solved(&self) -> bool {
        *self == Self::Replied(Status::Solved)
    }
}
