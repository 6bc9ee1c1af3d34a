//! The fields of a request that a server needs before it queues it, read without its tensors.

use prost::Message;

use crate::{Invalid, LibraryId, Limits, check};

/// The first fields of `egp.v1.StepRequest`; protobuf skips the others.
#[derive(Clone, PartialEq, Message)]
struct Fields {
    #[prost(uint32, tag = "1")]
    version: u32,
    #[prost(bytes = "vec", tag = "2")]
    library: Vec<u8>,
    #[prost(uint64, tag = "3")]
    sequence: u64,
    #[prost(uint32, tag = "4")]
    budget_us: u32,
}

/// What admission decides on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Library the request pins.
    pub library: LibraryId,
    /// Its sequence number.
    pub sequence: u64,
    /// Time left for the answer when it was sent, microseconds.
    pub budget_us: u32,
}

impl Header {
    /// Reads the header of an encoded request.
    ///
    /// # Errors
    /// [`Invalid`] when the message is too large, no protobuf, of another version, or its header is
    /// malformed. The other fields are left to [`crate::Request::decode`].
    pub fn decode(bytes: &[u8], limits: &Limits) -> Result<Self, Invalid> {
        check::size(bytes, limits.message_bytes)?;
        let fields = Fields::decode(bytes)?;
        check::version(fields.version)?;
        check::budget(fields.budget_us)?;
        Ok(Self {
            library: check::library(&fields.library)?,
            sequence: fields.sequence,
            budget_us: fields.budget_us,
        })
    }
}
