//! Why no library was fetched.

use std::io;

use egp_core::library::{LibraryError, MAX_FILE_BYTES};
use egp_wire::keys::Name;
use egp_wire::{Invalid, WireError};
use thiserror::Error;

use crate::signature::SignatureError;
use egp_session::NetworkError;

/// Why a replica's library is not used.
#[derive(Debug, Error)]
pub enum FetchFailure {
    /// The replica answered with an error.
    #[error(transparent)]
    Refused(#[from] WireError),
    /// Its answer is no `egp.v1.LibraryFile`.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// It states more bytes than a library may have.
    #[error("it has {bytes} bytes, a library at most {MAX_FILE_BYTES}")]
    TooLarge {
        /// The stated number.
        bytes: u64,
    },
    /// A part has the wrong length.
    #[error("expected {expected} bytes in part {part}, got {actual}")]
    Part {
        /// Number of the part, from 0.
        part: u32,
        /// Bytes that belong to it.
        expected: usize,
        /// Bytes that came.
        actual: usize,
    },
    /// No answer came for a part.
    #[error("no answer for part {part} of {parts}; the replica or the link is gone")]
    Gone {
        /// Number of the part, from 0.
        part: u32,
        /// The number of parts.
        parts: u32,
    },
    /// The transfer took too long.
    #[error("{bytes} bytes came in {seconds:.0} s, which is too slow")]
    Slow {
        /// Bytes that came.
        bytes: usize,
        /// Time of the transfer, s.
        seconds: f64,
    },
    /// The bytes are not those of the hash.
    #[error("what it sent has SHA-256 {actual}")]
    Hash {
        /// The hash of what was sent.
        actual: String,
    },
    /// The replica has no signature, and public keys are configured.
    #[error("it has no signature; sign the library with `egp sign` where it comes from")]
    Unsigned,
    /// The signature is of none of the public keys.
    #[error(transparent)]
    Signature(#[from] SignatureError),
    /// The bytes are no library that this version can use.
    #[error("it cannot be used: {0}")]
    Library(#[from] LibraryError),
}

/// Why no library was fetched. The file is as before.
#[derive(Debug, Error)]
pub enum FetchError {
    /// An operation of zenoh that failed.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// The public keys cannot be used.
    #[error(transparent)]
    Keys(#[from] SignatureError),
    /// No replica answered.
    #[error(
        "no replica answered a question for library {library} within {seconds:.0} s; check the endpoints, and whether \
         access control lets this identity fetch libraries"
    )]
    NoAnswer {
        /// Hash of the library.
        library: String,
        /// The time that was waited, s.
        seconds: f64,
    },
    /// Replicas answered, and none of them gave the library.
    #[error("no replica gave library {library}: {}", tell(.failures))]
    Failed {
        /// Hash of the library.
        library: String,
        /// The reasons, each with its replica if the answer stated one.
        failures: Vec<(Option<Name>, FetchFailure)>,
    },
    /// The file cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: String,
        /// The error of the system.
        source: io::Error,
    },
    /// The file does not hold the library yet.
    #[error(
        "{path} does not hold library {library} yet; a service that starts fetches it, a check does not"
    )]
    Absent {
        /// The file.
        path: String,
        /// Hash of the library.
        library: String,
    },
    /// A signal came.
    #[error("fetching library {library} was ended by a signal")]
    Stopped {
        /// Hash of the library.
        library: String,
    },
}

/// The reasons, each with the name of its replica once: an error of a replica begins with it.
fn tell(failures: &[(Option<Name>, FetchFailure)]) -> String {
    let one = |(replica, failure): &(Option<Name>, FetchFailure)| {
        let told = failure.to_string();
        let Some(replica) = replica.as_ref().map(|name| format!("replica {name}")) else {
            return told;
        };
        let named = (told.strip_prefix(&replica)).is_some_and(|rest| rest.starts_with([':', ' ']));
        if named {
            told
        } else {
            format!("{replica}: {told}")
        }
    };
    failures.iter().map(one).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_wire::Code;

    use super::*;

    #[test]
    fn each_reason_names_its_replica_once() {
        let refused = |detail: &str| {
            let error = WireError::retryable(Code::UnknownLibrary, 0, detail);
            FetchFailure::Refused(error)
        };
        let name = |text: &str| Some(text.parse::<Name>().unwrap());
        for (replica, failure, told) in [
            (None, refused("replica a does not"), "replica a does not"),
            (name("a"), refused("replica a: busy"), "replica a: busy"),
            (
                name("a"),
                refused("replica ab: x"),
                "replica a: replica ab: x",
            ),
            (name("a"), refused("busy"), "replica a: busy"),
            (
                name("a"),
                FetchFailure::Unsigned,
                "replica a: it has no signature; sign the library with `egp sign` where it comes from",
            ),
        ] {
            assert_eq!(tell(&[(replica, failure)]), told);
        }
    }
}
