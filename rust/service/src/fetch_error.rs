//! Why no library was fetched.

use std::collections::BTreeSet;
use std::io;

use egp_core::library::{LibraryError, MAX_FILE_BYTES};
use egp_wire::keys::Name;
use egp_wire::{Code, Invalid, WireError};
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

impl FetchFailure {
    /// Whether the replica would fail in the same way if it were asked again soon.
    pub(crate) fn is_final(&self) -> bool {
        match self {
            Self::Gone { .. } => false,
            Self::Refused(error) => error.code == Code::UnknownLibrary,
            _ => true,
        }
    }
}

/// Why no library was fetched. The files of the library and of its signature are as before, except in two cases of
/// [`FetchError::Write`]: both are new if only the writing of the folder's entries to the disk failed, and the signature alone
/// is new, or removed, if the system refused to replace the library and then to put the earlier signature back, which the message says.
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

/// Largest number of failures that the text of an error states.
const TOLD: usize = 16;

/// The failures of the replicas that were asked for a library.
#[derive(Default)]
pub(crate) struct Failures {
    /// At most [`TOLD`], each with its replica if the answer stated one.
    told: Vec<(Option<Name>, FetchFailure)>,
    /// The replicas that sent what cannot be used, and are not asked for parts again.
    given_up: BTreeSet<Name>,
}

impl Failures {
    /// Takes note of a failure. A later failure of the same replica replaces the earlier one.
    pub(crate) fn note(&mut self, replica: Option<Name>, failure: FetchFailure) {
        // A replica that refuses may load the library later.
        let refused = matches!(failure, FetchFailure::Refused(_));
        let is_given_up = failure.is_final() && !refused;
        if let Some(replica) = replica.as_ref().filter(|_| is_given_up) {
            self.given_up.insert(replica.clone());
        }
        let text = failure.to_string();
        self.told.retain(|(known, earlier)| {
            *known != replica || (replica.is_none() && earlier.to_string() != text)
        });
        if self.told.len() < TOLD {
            self.told.push((replica, failure));
        }
    }

    /// Whether the replica sent what cannot be used.
    pub(crate) fn is_given_up(&self, replica: &Name) -> bool {
        self.given_up.contains(replica)
    }

    /// The failures that an error states.
    pub(crate) fn told(self) -> Vec<(Option<Name>, FetchFailure)> {
        self.told
    }
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
    fn every_replica_with_a_wrong_library_is_given_up_and_a_few_are_told() {
        let replica = |number| format!("replica-{number}").parse::<Name>().unwrap();
        let gone = || FetchFailure::Gone { part: 0, parts: 1 };
        let mut failures = Failures::default();
        for number in 0..40 {
            failures.note(Some(replica(number)), gone());
        }
        assert!((0..40).all(|number| !failures.is_given_up(&replica(number))));
        for number in 0..40 {
            failures.note(Some(replica(number)), FetchFailure::Unsigned);
        }
        assert!((0..40).all(|number| failures.is_given_up(&replica(number))));
        assert!(!failures.is_given_up(&replica(40)));
        assert_eq!(failures.told().len(), TOLD);
    }

    #[test]
    fn the_last_failure_of_each_replica_is_told() {
        let refused = |detail: &str| {
            let error = WireError::retryable(Code::UnknownLibrary, 0, detail);
            FetchFailure::Refused(error)
        };
        let (name, mut failures) = ("a".parse::<Name>().unwrap(), Failures::default());
        failures.note(Some(name.clone()), refused("busy"));
        failures.note(None, refused("replica x: busy"));
        failures.note(None, refused("replica y: busy"));
        failures.note(None, refused("replica x: busy"));
        failures.note(Some(name), FetchFailure::Unsigned);
        let told = tell(&failures.told());
        assert!(
            told.starts_with("replica y: busy; replica x: busy; replica a: it has no signature"),
            "{told}"
        );
    }

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
