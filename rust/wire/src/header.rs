//! The fields of a request that a server needs before it queues it, read without its tensors.

use crate::fields::Fields;
use crate::{Invalid, LibraryId, check, limits};

/// The fields that decide on admission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// SHA-256 of the library that the request states.
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
    /// [`Invalid`] if the message is too large, not protobuf, of another version, or has a malformed header.
    /// [`crate::Request::decode`] checks the other fields.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        check::size(bytes, limits::MESSAGE_BYTES)?;
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
