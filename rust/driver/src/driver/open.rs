//! What a driver waits for: its queries, and the control period that is not decided yet.

use egp_wire::keys::Name;
use egp_wire::{Request, Tag, WireError};

use super::Time;
use crate::action::QueryId;
use crate::situation::{Lost, Situation};
use crate::step::Outcome;

/// A request that was sent, for the time in which its reply is of use.
#[derive(Clone, Debug)]
pub(super) struct Pending {
    pub(super) replica: Name,
    pub(super) sent: Time,
    /// Deadline of its control period.
    pub(super) due: Time,
    pub(super) request: Request,
    /// The tag of the question, if the vehicle has a key.
    pub(super) tag: Option<Tag>,
    /// Whether an answer without the key's tag came.
    pub(super) forged: bool,
    /// Whether the failure of this query was counted against its replica. What comes later does not demote it again.
    pub(super) counted: bool,
    /// Whether another replica's answer decided the period.
    pub(super) decided_without: bool,
    /// An error that may concern one of two copies of the question only.
    pub(super) refusal: Option<WireError>,
}

/// A query of a replica's `ready` key.
#[derive(Clone, Debug)]
pub(super) struct Probe {
    pub(super) replica: Name,
    pub(super) sent: Time,
    pub(super) tag: Option<Tag>,
}

/// A control period that is not decided yet.
#[derive(Clone, Debug)]
pub(super) struct Running {
    pub(super) begun: Time,
    pub(super) deadline: Time,
    /// When the next replica is asked although those asked before may still answer.
    pub(super) hedge: Option<Time>,
    pub(super) request: Request,
    pub(super) bytes: Vec<u8>,
    /// Replicas still to be asked, the next one last.
    pub(super) remaining: Vec<Name>,
    pub(super) asked: u32,
    /// The queries whose answers are awaited, with their replicas.
    pub(super) awaited: Vec<(QueryId, Name)>,
    /// The replica that replied, or that failed or was asked last.
    pub(super) replica: Option<Name>,
    /// The outcome of the queries so far.
    pub(super) outcome: Outcome,
    pub(super) situation: Situation,
    pub(super) lost: Option<Lost>,
}

impl Running {
    /// Waits no longer for the queries that `ended` names; returns whether there was one.
    pub(super) fn end(&mut self, ended: impl Fn(QueryId, &Name) -> bool) -> bool {
        let before = self.awaited.len();
        self.awaited.retain(|(id, replica)| !ended(*id, replica));
        self.awaited.len() < before
    }
}
