//! What a replica tells about itself to a client that is about to use it.

use prost::Message as _;

use crate::{Invalid, LibraryId, Limits, VERSION, check, proto};

/// Answer of a replica's `ready` key.
#[derive(Clone, Debug, PartialEq)]
pub struct Ready {
    /// False while the replica drains.
    pub ready: bool,
    /// The library it serves.
    pub library: LibraryId,
    /// Control period, s.
    pub dt: f64,
    /// Inputs in a plan, T.
    pub horizon: u32,
    /// Transitions worth carrying, K.
    pub history: u32,
    /// The members' surfaces, in the order of the weights.
    pub members: Vec<String>,
}

impl Ready {
    /// Bytes of an `egp.v1.Ready`.
    pub fn encode(&self) -> Vec<u8> {
        proto::Ready {
            version: VERSION,
            ready: self.ready,
            library: self.library.to_vec(),
            dt: self.dt,
            horizon: self.horizon,
            history: self.history,
            members: self.members.clone(),
        }
        .encode_to_vec()
    }

    /// Reads and validates an `egp.v1.Ready`.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8], limits: &Limits) -> Result<Self, Invalid> {
        check::size(bytes, limits.message_bytes)?;
        let raw = proto::Ready::decode(bytes)?;
        check::version(raw.version)?;
        if !(raw.dt > 0.0 && raw.dt <= 1.0) {
            return Err(Invalid::field(
                "dt",
                format!("expected seconds in (0, 1], got {}", raw.dt),
            ));
        }
        check::at_most(
            "horizon",
            raw.horizon,
            limits.horizon,
            "the limit of this side",
        )?;
        check::at_most(
            "history",
            raw.history,
            limits.history,
            "the limit of this side",
        )?;
        Ok(Self {
            ready: raw.ready,
            library: check::library(&raw.library)?,
            dt: raw.dt,
            horizon: raw.horizon,
            history: raw.history,
            members: raw.members,
        })
    }
}
