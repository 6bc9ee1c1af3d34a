//! The interface by which intake and workers see a query that a network delivered.

use std::borrow::Cow;

use egp_wire::{Code, Invalid, WireError, limits};

/// Largest attachment of a query in bytes. The seal of a vehicle, the only one there is, has at most about 200.
const ATTACHMENT: usize = 512;

/// A query that is answered exactly once, by a reply or by an error.
pub trait Query {
    /// The key that was asked.
    fn key(&self) -> &str;

    /// Length of the payload in bytes.
    fn length(&self) -> usize;

    /// The bytes that were sent, which are copied if they came in several parts.
    fn payload(&self) -> Cow<'_, [u8]>;

    /// Length of the attachment in bytes.
    fn attachment_length(&self) -> usize;

    /// The attachment; empty if there is none.
    fn attachment(&self) -> Cow<'_, [u8]>;

    /// Replies on `key`, which must match the query's.
    fn answer(
        &self,
        key: &str,
        payload: Vec<u8>,
        encoding: &'static str,
        attachment: Option<Vec<u8>>,
    );

    /// Replies with an error.
    fn refuse(&self, error: &WireError);
}

/// Errors if a query has a larger attachment than any seal: it would be copied several times on the network's receive thread
/// before it is known who sent it.
pub(crate) fn check_attachment(query: &impl Query) -> Result<(), WireError> {
    let actual = query.attachment_length();
    if actual <= ATTACHMENT {
        return Ok(());
    }
    let detail = format!("expected an attachment of at most {ATTACHMENT} bytes, got {actual}");
    Err(WireError::permanent(Code::Malformed, detail))
}

/// The error about a query of a key that is not served. `expected` completes the sentence that begins with the key and "is".
/// Anybody can ask for any key, and the text goes into logs and terminals, so that control characters in the key are escaped.
pub(crate) fn no_such_key(key: &str, expected: &str) -> WireError {
    let detail = format!("{} is {expected}", key.escape_debug());
    WireError::permanent(Code::Malformed, detail)
}

/// An answer to a question of this side.
pub(crate) struct Answer {
    /// The key of a reply; none if it is an error.
    pub(crate) key: Option<String>,
    /// The reply, or the error that was sent in its place.
    pub(crate) content: Result<Vec<u8>, WireError>,
}

impl Answer {
    /// A reply, whose payload is an error if it is larger than any message.
    pub(crate) fn reply(key: &str, payload: &[u8]) -> Self {
        let (limit, actual) = (limits::MESSAGE_BYTES, payload.len());
        Self {
            key: Some(key.to_owned()),
            content: if actual > limit {
                Err(Invalid::TooLarge { limit, actual }.into())
            } else {
                Ok(payload.to_vec())
            },
        }
    }

    /// An error; none if it is the network's own, for a question that nobody answered in time.
    pub(crate) fn error(payload: &[u8]) -> Option<Self> {
        let small = payload.len() <= limits::MESSAGE_BYTES;
        let error = small.then(|| WireError::decode(payload).ok())?;
        error.map(|error| Self {
            key: None,
            content: Err(error),
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
pub(crate) mod recorded {
    //! Queries and a handler for the unit tests of this crate.

    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Arc, Mutex};
    use std::time::{Duration, Instant};

    use egp_testing::messages;
    use egp_wire::keys::{self, Name};
    use egp_wire::{Code, Header, Ready, Status, Timing};
    use prost::Message as _;

    use super::{Cow, Query, WireError};
    use crate::handler::Handler;

    /// What was sent as the answer to a query.
    #[derive(Clone, Debug, PartialEq)]
    pub(crate) enum Sent {
        Answer {
            key: String,
            payload: Vec<u8>,
            timing: Option<Timing>,
        },
        Error(WireError),
    }

    /// A query that keeps its answers. Clones are the same query.
    #[derive(Clone)]
    pub(crate) struct Recorded {
        pub(crate) key: String,
        pub(crate) payload: Vec<u8>,
        pub(crate) attachment: Vec<u8>,
        /// The length that the network states.
        pub(crate) length: usize,
        sent: Arc<Mutex<Vec<Sent>>>,
    }

    pub(crate) fn name(text: &str) -> Name {
        text.parse().unwrap()
    }

    /// `ms` milliseconds after `start`.
    pub(crate) fn at(start: Instant, ms: f64) -> Instant {
        start + Duration::from_secs_f64(ms * 1e-3)
    }

    impl Recorded {
        pub(crate) fn new(key: &str, payload: Vec<u8>) -> Self {
            Self {
                key: key.to_owned(),
                length: payload.len(),
                payload,
                attachment: Vec::new(),
                sent: Arc::default(),
            }
        }

        /// A request of a vehicle of `fleet` to the replica `main`, with a budget in microseconds.
        pub(crate) fn request(vehicle: &str, sequence: u64, budget_us: u32) -> Self {
            let mut request = messages::cold_request();
            (request.sequence, request.budget_us) = (sequence, budget_us);
            let key = keys::step(&name("main"), &name("fleet"), &name(vehicle));
            Self::new(&key, request.encode())
        }

        /// The only answer; none if there is no answer yet.
        pub(crate) fn sent(&self) -> Option<Sent> {
            let sent = self.sent.lock().unwrap();
            assert!(sent.len() < 2, "{sent:?}");
            sent.first().cloned()
        }

        /// The error that was sent.
        pub(crate) fn error(&self) -> Option<WireError> {
            match self.sent() {
                Some(Sent::Error(error)) => Some(error),
                _ => None,
            }
        }

        /// The code of the error that was sent.
        pub(crate) fn code(&self) -> Option<Code> {
            self.error().map(|error| error.code)
        }
    }

    impl Query for Recorded {
        fn key(&self) -> &str {
            &self.key
        }

        fn length(&self) -> usize {
            self.length
        }

        fn payload(&self) -> Cow<'_, [u8]> {
            Cow::Borrowed(&self.payload)
        }

        fn attachment_length(&self) -> usize {
            self.attachment.len()
        }

        fn attachment(&self) -> Cow<'_, [u8]> {
            assert!(
                self.attachment.len() <= super::ATTACHMENT,
                "it is too large to be read"
            );
            Cow::Borrowed(&self.attachment)
        }

        fn answer(
            &self,
            key: &str,
            payload: Vec<u8>,
            _encoding: &'static str,
            attachment: Option<Vec<u8>>,
        ) {
            let timing = attachment.map(|bytes| Timing::decode(&*bytes).unwrap());
            self.sent.lock().unwrap().push(Sent::Answer {
                key: key.to_owned(),
                payload,
                timing,
            });
        }

        fn refuse(&self, error: &WireError) {
            self.sent.lock().unwrap().push(Sent::Error(error.clone()));
        }
    }

    /// Replies with the number of the workspace, counted from 0, and the sequence number. It panics at [`Echo::PANICS`].
    #[derive(Default)]
    pub(crate) struct Echo(AtomicUsize);

    impl Echo {
        pub(crate) const PANICS: u64 = 13;
    }

    impl Handler for Echo {
        type Workspace = usize;

        fn describe(&self) -> Ready {
            messages::ready()
        }

        fn workspace(&self) -> Result<usize, WireError> {
            Ok(self.0.fetch_add(1, Ordering::Relaxed))
        }

        fn step(
            &self,
            workspace: &mut usize,
            request: &[u8],
            reply: &mut Vec<u8>,
        ) -> Result<Status, WireError> {
            let sequence = Header::decode(request)?.sequence;
            assert_ne!(sequence, Self::PANICS, "on purpose");
            *reply = format!("{workspace}:{sequence}").into_bytes();
            Ok(Status::IterationLimit)
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::intake::tests::shared;
    use crate::query::recorded::Recorded;

    #[test]
    fn an_attachment_that_is_larger_than_a_seal_is_not_read() {
        let shared = shared(1);
        let ready = Recorded::new("egp/v1/r/main/ready", Vec::new());
        for mut query in [ready, Recorded::request("a", 1, 16_000)] {
            query.attachment = vec![7; ATTACHMENT + 1];
            shared.take(query.clone(), Instant::now());
            let error = query.error().unwrap();
            assert_eq!(error.code, Code::Malformed);
            assert!(
                error.detail.contains("at most 512 bytes, got 513"),
                "{error}"
            );
        }
        let mut query = Recorded::request("b", 1, 16_000);
        query.attachment = vec![7; ATTACHMENT];
        shared.take(query.clone(), Instant::now());
        assert_eq!(query.sent(), None);
    }
}
