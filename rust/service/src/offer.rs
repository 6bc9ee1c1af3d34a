//! The library files that a replica serves, offered to other replicas in parts.
//!
//! A thread of its own answers, neither the network's receive thread nor a worker, and not more than [`RATE`] bytes a second,
//! so that vehicles get their plans in time while libraries are copied.

use std::time::Duration;

use egp_core::library;
use egp_wire::keys::Name;
use egp_wire::library_keys;
use egp_wire::{Code, LIBRARY_PART_BYTES, LibraryFile, LibraryId, WireError};

use crate::handler::LibraryContent;
use crate::intake::Shared;
use crate::metrics::Metrics;
use crate::query::Query;
use crate::sync::mpsc::{self, Receiver, SyncSender, TrySendError};
use crate::sync::{Mutex, PoisonError, thread};

/// Most bytes of libraries that are sent a second, to all who ask together: a quarter of a link of 1 Gbit/s.
const RATE: u32 = 32 << 20;

/// Questions that wait at a time; who asks beyond them gets an error. Each receiver asks for one part at a time.
const WAITING: usize = 16;

/// A question for a library, or for a part of it.
pub(crate) struct Asked<Q> {
    query: Q,
    id: LibraryId,
    part: Option<u32>,
}

/// Where the receive thread leaves questions for the thread that answers them.
pub(crate) struct Offer<Q>(Mutex<Option<SyncSender<Asked<Q>>>>);

impl<Q: Query> Offer<Q> {
    /// An offer, and the questions that it takes.
    pub(crate) fn new() -> (Self, Receiver<Asked<Q>>) {
        let (sender, receiver) = mpsc::sync_channel(WAITING);
        (Self(Mutex::new(Some(sender))), receiver)
    }

    /// The offer of a replica without library files.
    pub(crate) fn none() -> Self {
        Self(Mutex::new(None))
    }

    /// Leaves a question for the thread, or answers it with an error, which `metrics` counts; returns at once. Errors begin
    /// with the name of the replica, because an error reply has no key that names who sent it.
    pub(crate) fn take(
        &self,
        query: Q,
        id: LibraryId,
        part: Option<u32>,
        replica: &Name,
        metrics: &Metrics,
    ) {
        let asked = Asked { query, id, part };
        let (asked, code, wait, detail) = match self.leave(asked) {
            Ok(()) => return,
            Err(TrySendError::Full(asked)) => {
                let detail = format!("{WAITING} questions for libraries wait already");
                // The questions that wait are answered meanwhile.
                let wait = pause(WAITING * LIBRARY_PART_BYTES).as_micros();
                (asked, Code::Overloaded, wait, detail)
            }
            Err(TrySendError::Disconnected(asked)) => {
                let detail = "it offers no libraries, or is about to end";
                (asked, Code::UnknownLibrary, 0, detail.to_owned())
            }
        };
        metrics.offered(false);
        let wait = u32::try_from(wait).unwrap_or(u32::MAX);
        let detail = format!("replica {replica}: {detail}");
        let error = WireError::retryable(code, wait, detail);
        asked.query.refuse(&error);
    }

    /// Leaves a question for the thread. The lock is released when this returns, so that an error is sent without it.
    fn leave(&self, asked: Asked<Q>) -> Result<(), TrySendError<Asked<Q>>> {
        match &*self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(sender) => sender.try_send(asked),
            None => Err(TrySendError::Disconnected(asked)),
        }
    }

    /// Lets the thread end once it has answered what waits.
    pub(crate) fn close(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

/// Answers questions until the offer is closed; `find` gives the file of a library that is served.
pub(crate) fn offer<Q: Query>(
    shared: &Shared<Q>,
    questions: &Receiver<Asked<Q>>,
    find: impl Fn(&LibraryId) -> Option<LibraryContent>,
) {
    while let Ok(asked) = questions.recv() {
        let sent = answer(shared, &asked, &find);
        shared.metrics.offered(sent.is_ok());
        match sent {
            Ok(bytes) => thread::sleep(pause(bytes)),
            Err(error) => asked.query.refuse(&error),
        }
    }
}

/// Answers one question: the number of bytes that were sent, or the error that is to be sent.
fn answer<Q: Query>(
    shared: &Shared<Q>,
    asked: &Asked<Q>,
    find: impl Fn(&LibraryId) -> Option<LibraryContent>,
) -> Result<usize, WireError> {
    let (replica, id) = (&shared.replica, &asked.id);
    let Some(LibraryContent { bytes, signature }) = find(id) else {
        let library = library::hex(id);
        let detail = format!("replica {replica} does not serve library {library}");
        return Err(WireError::retryable(Code::UnknownLibrary, 0, detail));
    };
    let Some(part) = asked.part else {
        let file = LibraryFile {
            bytes: bytes.len() as u64,
            signature,
        };
        let (key, encoding) = (
            library_keys::library(replica, id),
            "application/protobuf;egp.v1.LibraryFile",
        );
        let message = file.encode();
        let length = message.len();
        asked.query.answer(&key, message, encoding, None);
        return Ok(length);
    };
    let mut parts = bytes.chunks(LIBRARY_PART_BYTES);
    let Some(content) = parts.nth(part as usize) else {
        let parts = bytes.len().div_ceil(LIBRARY_PART_BYTES);
        let detail =
            format!("replica {replica}: this library has {parts} parts from 0 on, not part {part}");
        return Err(WireError::permanent(Code::Malformed, detail));
    };
    let key = library_keys::library_part(replica, id, part);
    let encoding = "application/octet-stream";
    asked.query.answer(&key, content.to_vec(), encoding, None);
    Ok(content.len())
}

/// The time in which this number of bytes may be sent.
fn pause(bytes: usize) -> Duration {
    let bytes = u32::try_from(bytes).unwrap_or(u32::MAX);
    Duration::from_secs_f64(f64::from(bytes) / f64::from(RATE))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use std::borrow::Cow;
    use std::time::Instant;

    use super::*;
    use crate::intake::tests::shared;
    use crate::query::recorded::{Recorded, Sent, name};
    use crate::sync::Arc;

    const ID: LibraryId = [7; 32];

    fn content() -> Vec<u8> {
        (0..251).cycle().take(2 * LIBRARY_PART_BYTES + 5).collect()
    }

    /// Asks on a key, and returns the answer of the thread.
    fn ask(key: &str) -> Recorded {
        let (offering, questions) = Offer::new();
        let mut shared = shared(1);
        shared.offer = offering;
        let query = Recorded::new(key, Vec::new());
        shared.take(query.clone(), Instant::now());
        assert_eq!(query.sent(), None, "the receive thread does not answer");
        shared.offer.close();
        let file = LibraryContent {
            bytes: Arc::from(content()),
            signature: Some([9; 64]),
        };
        offer(&shared, &questions, |id| (*id == ID).then(|| file.clone()));
        query
    }

    fn sent(query: &Recorded) -> (String, Vec<u8>) {
        match query.sent() {
            Some(Sent::Answer { key, payload, .. }) => (key, payload),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_parts_of_a_library_are_its_file() {
        let main = name("main");
        let (key, message) = sent(&ask(&library_keys::any_library(&ID)));
        assert_eq!(key, library_keys::library(&main, &ID));
        let file = LibraryFile::decode(&message).unwrap();
        assert_eq!(file.bytes, content().len() as u64);
        assert_eq!(file.signature, Some([9; 64]));
        let parts = (0..3).map(|part| {
            let key = library_keys::library_part(&main, &ID, part);
            let (answered, bytes) = sent(&ask(&key));
            assert_eq!(answered, key);
            bytes
        });
        assert_eq!(parts.collect::<Vec<_>>().concat(), content());
    }

    #[test]
    fn what_is_not_there_is_an_error() {
        let main = name("main");
        let beyond = ask(&library_keys::library_part(&main, &ID, 3))
            .error()
            .unwrap();
        assert_eq!((beyond.code, beyond.retryable), (Code::Malformed, false));
        assert!(beyond.detail.contains("3 parts"), "{beyond}");
        assert!(beyond.detail.starts_with("replica main: "), "{beyond}");
        let unknown = ask(&library_keys::library(&main, &[8; 32]))
            .error()
            .unwrap();
        assert_eq!(unknown.code, Code::UnknownLibrary);
        assert!(unknown.detail.starts_with("replica main "), "{unknown}");
    }

    #[test]
    fn questions_beyond_those_that_wait_get_an_error_at_once() {
        let (offering, questions) = Offer::new();
        let metrics = Metrics::new(&[], 1);
        let take = |query| offering.take(query, ID, None, &name("main"), &metrics);
        let key = library_keys::any_library(&ID);
        let query = || Recorded::new(&key, Vec::new());
        for _ in 0..WAITING {
            take(query());
        }
        let last = query();
        take(last.clone());
        let full = last.error().unwrap();
        assert_eq!((full.code, full.retryable), (Code::Overloaded, true));
        assert_eq!(full.retry_after_us, 31_250);
        assert!(full.detail.starts_with("replica main: "), "{full}");
        offering.close();
        let closed = query();
        take(closed.clone());
        assert_eq!(closed.code(), Some(Code::UnknownLibrary));
        let closed = closed.error().unwrap();
        assert!(closed.detail.starts_with("replica main: "), "{closed}");
        assert_eq!(questions.iter().count(), WAITING);
        let refused = "egp_library_questions_total{outcome=\"refused\"} 2";
        assert!(metrics.text(0).contains(refused));
    }

    /// A query whose error can be sent only while the offer is not locked.
    struct Sending(Arc<Offer<Self>>);

    impl Query for Sending {
        fn key(&self) -> &'static str {
            ""
        }

        fn length(&self) -> usize {
            0
        }

        fn payload(&self) -> Cow<'_, [u8]> {
            Cow::default()
        }

        fn attachment_length(&self) -> usize {
            0
        }

        fn attachment(&self) -> Cow<'_, [u8]> {
            Cow::default()
        }

        fn answer(&self, _: &str, _: Vec<u8>, _: &'static str, _: Option<Vec<u8>>) {}

        fn refuse(&self, _: &WireError) {
            assert!(self.0.0.try_lock().is_ok(), "the offer is locked");
        }
    }

    #[test]
    fn the_offer_is_not_locked_while_an_error_is_sent() {
        let (offering, questions) = Offer::new();
        let (offering, metrics) = (Arc::new(offering), Metrics::new(&[], 1));
        let take = || {
            let query = Sending(offering.clone());
            offering.take(query, ID, None, &name("main"), &metrics);
        };
        for _ in 0..=WAITING {
            take();
        }
        offering.close();
        take();
        assert_eq!(questions.iter().count(), WAITING);
        let refused = "egp_library_questions_total{outcome=\"refused\"} 2";
        assert!(metrics.text(0).contains(refused));
    }

    #[test]
    fn parts_are_sent_at_a_limited_rate() {
        let second: Duration = (0..512).map(|_| pause(LIBRARY_PART_BYTES)).sum();
        assert!((second.as_secs_f64() - 1.0).abs() < 1e-6, "{second:?}");
    }
}
