//! The actions that a driver returns to its transport.

use std::time::Duration;

use egp_wire::keys::Name;

use crate::step::Step;

/// Names a query from [`Action::Ask`] or [`Action::Probe`] to its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct QueryId(pub u64);

/// A question to a replica.
#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    /// To be named with the answer.
    pub id: QueryId,
    /// The replica.
    pub replica: Name,
    /// Key to ask.
    pub key: String,
    /// Bytes to send.
    pub payload: Vec<u8>,
    /// Bytes to attach; empty if there are none.
    pub attachment: Vec<u8>,
    /// How long to listen for the answer.
    pub listen: Duration,
}

/// What the transport is to do.
#[derive(Clone, Debug)]
pub enum Action {
    /// Ask a replica for a control step.
    Ask(Query),
    /// Ask a replica what it serves, to find out whether it answers again.
    Probe(Query),
    /// Give this step's command to the actuators; the control period is decided.
    Command(Box<Step>),
}
