//! What an exchange with a fleet's map has to say to people.

use std::fmt;

use egp_wire::{Invalid, WireError};

/// What a map service does not do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Answer questions about a road.
    Questions,
    /// Accept evidence.
    Evidence,
}

/// Something that an engineer may want to know. Driving goes on.
#[derive(Clone, Debug, PartialEq)]
pub enum FleetNotice {
    /// A query had no answer, and the one before it had one.
    NoAnswer,
    /// An answer is no valid message.
    UnreadableAnswer(Invalid),
    /// A publication is no valid message.
    UnreadablePublication(Invalid),
    /// The service answers with an error.
    Refused(Purpose, WireError),
    /// At the end the evidence about this many tiles could not be sent.
    Unsent(usize),
}

impl FleetNotice {
    /// Whether something is wrong; otherwise there is only no map service.
    pub fn is_warning(&self) -> bool {
        *self != Self::NoAnswer
    }

    /// Kind and code of an error of which one notice is enough.
    pub(super) fn kind(&self) -> Option<(&'static str, i32)> {
        match self {
            Self::NoAnswer | Self::Unsent(_) => None,
            Self::UnreadableAnswer(_) => Some(("answer", 0)),
            Self::UnreadablePublication(_) => Some(("publication", 0)),
            Self::Refused(Purpose::Questions, error) => Some(("question", error.code as i32)),
            Self::Refused(Purpose::Evidence, error) => Some(("evidence", error.code as i32)),
        }
    }
}

impl fmt::Display for FleetNotice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoAnswer => f.write_str("no map service answers; driving goes on without it"),
            Self::UnreadableAnswer(error) => {
                write!(f, "an answer of the map service cannot be read: {error}")
            }
            Self::UnreadablePublication(error) => {
                write!(
                    f,
                    "a publication of the map service cannot be read: {error}"
                )
            }
            Self::Refused(purpose, error) => {
                let purpose = match purpose {
                    Purpose::Questions => "answer questions",
                    Purpose::Evidence => "accept evidence",
                };
                let code = error.code_name();
                write!(f, "the map service does not {purpose}: {code}: {error}")
            }
            Self::Unsent(tiles) => {
                write!(
                    f,
                    "the evidence about {tiles} tiles of the road was not sent"
                )
            }
        }
    }
}
