//! The actions that an exchange with a fleet's map returns to its transport.

use std::time::Duration;

use super::FleetNotice;
use crate::action::QueryId;

/// A question or evidence for the map service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapQuery {
    /// To be named with the answers and with the end.
    pub id: QueryId,
    /// Key to ask.
    pub key: String,
    /// An `egp.v1.TileEvidence` to send, or `None` for a question.
    pub payload: Option<Vec<u8>>,
    /// How long to listen for the answer.
    pub listen: Duration,
}

/// What the transport is to do.
#[derive(Clone, Debug, PartialEq)]
pub enum FleetAction {
    /// Ask the map service. A query that cannot be sent has ended ([`crate::FleetExchange::ended`]).
    Ask(MapQuery),
    /// Tell the vehicle's engineer, or log it.
    Notice(FleetNotice),
}
