//! The fields of a request that a server needs before it queues it, read without its tensors.

use crate::fields::Fields;
use crate::{Invalid, LibraryId, Limits, check};

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
        let (mut version, mut library, mut sequence, mut budget_us) = (0, [].as_slice(), 0, 0);
        for field in Fields::of(bytes) {
            let (tag, value) = field?;
            match tag {
                1 => version = value.uint32("version")?,
                2 => library = value.bytes("library")?,
                3 => sequence = value.uint64("sequence")?,
                4 => budget_us = value.uint32("budget_us")?,
                _ => {}
            }
        }
        check::version(version)?;
        check::budget(budget_us)?;
        Ok(Self {
            library: check::library(library)?,
            sequence,
            budget_us,
        })
    }
}
