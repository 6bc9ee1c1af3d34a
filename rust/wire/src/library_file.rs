//! What a replica says about a library file before it is fetched in parts.

use prost::Message as _;

use crate::{Invalid, LIBRARY_PART_BYTES, VERSION, check, limits, proto};

/// Answer of a replica that has a library.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LibraryFile {
    /// Bytes of the file, at least 1.
    pub bytes: u64,
    /// The Ed25519 signature of the library, if the replica has one.
    pub signature: Option<[u8; 64]>,
}

impl LibraryFile {
    /// Number of the parts in which the file is answered.
    pub fn parts(&self) -> u64 {
        self.bytes.div_ceil(LIBRARY_PART_BYTES as u64)
    }

    /// Bytes of an `egp.v1.LibraryFile`.
    pub fn encode(&self) -> Vec<u8> {
        proto::LibraryFile {
            version: VERSION,
            bytes: self.bytes,
            signature: self.signature.map(Vec::from).unwrap_or_default(),
        }
        .encode_to_vec()
    }

    /// Reads and validates an `egp.v1.LibraryFile`.
    ///
    /// # Errors
    /// [`Invalid`], which names the first field at fault.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        check::size(bytes, limits::MESSAGE_BYTES)?;
        let raw = proto::LibraryFile::decode(bytes)?;
        check::version(raw.version)?;
        if raw.bytes == 0 {
            return Err(Invalid::field("bytes", "expected at least 1, got 0"));
        }
        let signature = match raw.signature.as_slice() {
            [] => None,
            given => Some(given.try_into().map_err(|_| {
                let reason = format!("expected 64 bytes or none, got {}", given.len());
                Invalid::field("signature", reason)
            })?),
        };
        Ok(Self {
            bytes: raw.bytes,
            signature,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn messages_read_back_and_mistakes_are_named() {
        let file = LibraryFile {
            bytes: 65_537,
            signature: Some([3; 64]),
        };
        assert_eq!(LibraryFile::decode(&file.encode()), Ok(file));
        assert_eq!(file.parts(), 2);
        let unsigned = LibraryFile {
            bytes: 65_536,
            signature: None,
        };
        assert_eq!(LibraryFile::decode(&unsigned.encode()), Ok(unsigned));
        assert_eq!(unsigned.parts(), 1);
        let wrong = |version, bytes, signature| {
            let message = proto::LibraryFile {
                version,
                bytes,
                signature,
            };
            let decoded = LibraryFile::decode(&message.encode_to_vec());
            decoded.unwrap_err().to_string()
        };
        assert!(wrong(2, 1, Vec::new()).contains("version 2"));
        assert!(wrong(1, 0, Vec::new()).starts_with("bytes:"));
        assert!(wrong(1, 1, vec![0; 63]).starts_with("signature:"));
        assert!(LibraryFile::decode(&[0xff]).is_err());
    }
}
