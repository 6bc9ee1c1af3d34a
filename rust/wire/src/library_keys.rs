//! Keys on which replicas offer the library files that they serve; `docs/wire.md` describes them.
//!
//! A library is addressed by its SHA-256, so that an answer of any replica can be checked without trusting the replica.

use crate::LibraryId;
use crate::hex::{from_hex, hex};
use crate::keys::{Name, PREFIX};

/// Bytes of each part of a library file but the last.
///
/// Zenoh sends a message of this size as one batch, between which messages of a higher priority are sent.
pub const LIBRARY_PART_BYTES: usize = 1 << 16;

pub(crate) const LIBRARY: &str = "library";

/// The key on which a replica says whether it has a library ([`crate::LibraryFile`]).
pub fn library(replica: &Name, id: &LibraryId) -> String {
    format!("{PREFIX}{replica}/{LIBRARY}/{}", hex(id))
}

/// The key expression that asks all replicas for a library.
pub fn any_library(id: &LibraryId) -> String {
    format!("{PREFIX}*/{LIBRARY}/{}", hex(id))
}

/// The key on which a replica answers part number `part` of a library file, counted from 0: its bytes.
pub fn library_part(replica: &Name, id: &LibraryId, part: u32) -> String {
    format!("{}/{part}", library(replica, id))
}

/// The replica whose answer on its key [`library`] this is.
pub fn replica_of_library(key: &str) -> Option<Name> {
    key.strip_prefix(PREFIX)?.split_once('/')?.0.parse().ok()
}

/// Reads what stands behind [`LIBRARY`] and a slash: the library, and the number of the part if there is one. Only the
/// digits with which the functions above write them are read, because an answer must have the key of its question.
pub(crate) fn parse(rest: &str) -> Option<(LibraryId, Option<u32>)> {
    let (digits, part) = match rest.split_once('/') {
        Some((digits, part)) => (digits, Some(part)),
        None => (rest, None),
    };
    let id = from_hex(digits).filter(|id| hex(id) == digits)?;
    let Some(text) = part else {
        return Some((id, None));
    };
    let part: u32 = text.parse().ok()?;
    (part.to_string() == text).then_some((id, Some(part)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::keys::{Target, parse};

    #[test]
    fn keys_read_back() {
        let main: Name = "main".parse().unwrap();
        let id: LibraryId = std::array::from_fn(|byte| u8::try_from(7 * byte).unwrap());
        let digits = hex(&id);
        let key = library(&main, &id);
        assert_eq!(key, format!("egp/v1/r/main/library/{digits}"));
        assert_eq!(replica_of_library(&key), Some(main.clone()));
        let whole = Some(Target::Library { id, part: None });
        assert_eq!(parse(&key), whole);
        assert_eq!(parse(&any_library(&id)), whole);
        let part = Some(Target::Library { id, part: Some(12) });
        assert_eq!(library_part(&main, &id, 12), format!("{key}/12"));
        assert_eq!(parse(&library_part(&main, &id, 12)), part);
    }

    #[test]
    fn other_keys_are_none() {
        let digits = "0f".repeat(32);
        for rest in [
            String::new(),
            digits[1..].to_owned(),
            format!("{digits}0"),
            format!("{digits}00"),
            format!("+{}", &digits[1..]),
            format!("{digits}/"),
            format!("{digits}/-1"),
            format!("{digits}/+1"),
            format!("{digits}/01"),
            digits.to_uppercase(),
            format!("{digits}/4294967296"),
            format!("{digits}/1/2"),
            format!("{}é", &digits[2..]),
        ] {
            assert_eq!(
                parse(&format!("egp/v1/r/main/library/{rest}")),
                None,
                "{rest}"
            );
        }
    }
}
