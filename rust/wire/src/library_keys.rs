//! Keys on which replicas offer the library files that they serve; `docs/wire.md` describes them.
//!
//! A library is addressed by its SHA-256, so that an answer of any replica can be checked without trusting the replica.

use crate::LibraryId;
use crate::keys::Name;

/// Bytes of each part of a library file but the last.
///
/// Zenoh sends a message of this size as one batch, between which messages of a higher priority are sent.
pub const LIBRARY_PART_BYTES: usize = 1 << 16;

pub(crate) const LIBRARY: &str = "library";
const PREFIX: &str = "egp/v1/r/";

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
    let id = library_id(digits).filter(|id| hex(id) == digits)?;
    let Some(text) = part else {
        return Some((id, None));
    };
    let part: u32 = text.parse().ok()?;
    (part.to_string() == text).then_some((id, Some(part)))
}

/// The SHA-256 that 64 hexadecimal digits state; none for another text.
pub fn library_id(digits: &str) -> Option<LibraryId> {
    let (pairs, []) = digits.as_bytes().as_chunks::<2>() else {
        return None;
    };
    let mut id = LibraryId::default();
    if pairs.len() != id.len() {
        return None;
    }
    for (byte, [high, low]) in id.iter_mut().zip(pairs) {
        let digit = |digit: &u8| char::from(*digit).to_digit(16);
        *byte = u8::try_from(16 * digit(high)? + digit(low)?).ok()?;
    }
    Some(id)
}

fn hex(id: &LibraryId) -> String {
    let digit = |value: u8| char::from_digit(value.into(), 16).unwrap_or_default();
    id.iter()
        .flat_map(|byte| [digit(byte >> 4), digit(byte & 15)])
        .collect()
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
        assert_eq!(library_id(&digits), Some(id));
        assert_eq!(library_id(&digits.to_uppercase()), Some(id));
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
        assert_eq!(library_id("*"), None);
    }
}
