//! A query that waits for its answer in the same process, and checks that there is one.

use std::borrow::Cow;
use std::cell::Cell;
use std::time::{Duration, Instant};

use egp_testing::messages;
use egp_wire::keys::{self, Name};
use egp_wire::{Code, WireError};

use crate::intake::Shared;
use crate::query::Query;
use crate::sync::mpsc::{Receiver, Sender, channel};

/// Bytes of the reply, or the code of the error.
pub(crate) type Answer = Result<Vec<u8>, Code>;

/// A query; dropping it without an answer and answering it twice fail the test.
pub(crate) struct Question {
    key: String,
    payload: Vec<u8>,
    attachment: Vec<u8>,
    asker: Sender<Answer>,
    answered: Cell<bool>,
}

/// A valid name.
pub(crate) fn name(text: &str) -> Name {
    #[allow(clippy::expect_used, reason = "the names are those of this crate")]
    text.parse().expect("a valid name")
}

/// The key of a vehicle's requests to the replica `main`.
pub(crate) fn step_key(vehicle: &str) -> String {
    keys::step(&name("main"), &name("fleet"), &name(vehicle))
}

/// The bytes of a request with this sequence number.
pub(crate) fn request(sequence: u64) -> Vec<u8> {
    let mut request = messages::cold_request();
    (request.sequence, request.budget_us) = (sequence, 10_000_000);
    request.encode()
}

impl Question {
    /// A request of a vehicle, and where its answer comes.
    pub(crate) fn new(
        vehicle: &str,
        payload: Vec<u8>,
        attachment: Vec<u8>,
    ) -> (Self, Receiver<Answer>) {
        let (asker, answer) = channel();
        let question = Self {
            key: step_key(vehicle),
            payload,
            attachment,
            asker,
            answered: Cell::new(false),
        };
        (question, answer)
    }

    /// Gives the question to a service. It states a time of arrival that is an hour ahead, so that no answer is late,
    /// however long the scheduler lets the service wait.
    pub(crate) fn ask(self, shared: &Shared<Self>) {
        shared.take(self, Instant::now() + Duration::from_secs(3600));
    }

    fn send(&self, answer: Answer) {
        assert!(!self.answered.replace(true), "a second answer");
        // The asker may have ended.
        let _ = self.asker.send(answer);
    }
}

impl Drop for Question {
    fn drop(&mut self) {
        assert!(
            self.answered.get() || std::thread::panicking(),
            "no answer to a request"
        );
    }
}

impl Query for Question {
    fn key(&self) -> &str {
        &self.key
    }

    fn length(&self) -> usize {
        self.payload.len()
    }

    fn payload(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.payload)
    }

    fn attachment_length(&self) -> usize {
        self.attachment.len()
    }

    fn attachment(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.attachment)
    }

    fn answer(
        &self,
        _key: &str,
        payload: Vec<u8>,
        _encoding: &'static str,
        _attachment: Option<Vec<u8>>,
    ) {
        self.send(Ok(payload));
    }

    fn refuse(&self, error: &WireError) {
        self.send(Err(error.code));
    }
}
