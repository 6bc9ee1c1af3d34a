//! One replica of the service, and the queries that it answers.

use std::borrow::Cow;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Duration;

use egp_driver::QueryId;
use egp_service::{Query, Replica};
use egp_wire::{LibraryId, WireError};

use crate::event::{Event, Message};
use crate::library::{File, ProcessLibraries};
use crate::router::Way;

/// Who asked, and with which query; a flood's queries have no vehicle.
pub(crate) type Asker = Option<(usize, QueryId)>;

/// A message that a replica has sent, with the asker and the way of the question that it answers.
pub(crate) struct Sent {
    pub(crate) asker: Asker,
    pub(crate) way: Option<Way>,
    pub(crate) message: Message,
}

/// Messages that are to be put on the links.
pub(crate) type Outbox = Rc<RefCell<Vec<Sent>>>;

/// A query on its way, which ends when it is dropped, as zenoh's does.
pub(crate) struct Exchange {
    pub(crate) key: String,
    pub(crate) payload: Vec<u8>,
    pub(crate) attachment: Vec<u8>,
    pub(crate) asker: Asker,
    /// The way on which it came; none without routers.
    pub(crate) way: Option<Way>,
    pub(crate) outbox: Outbox,
    /// Answers sent on this query, to be counted by the oracle.
    pub(crate) answers: Rc<Cell<u32>>,
    /// Shared by the copies of one query that take different routes; the query ends with the last of them.
    pub(crate) copies: Rc<()>,
}

impl Exchange {
    /// The same query, as it arrives on another way.
    pub(crate) fn copy(&self, way: Option<Way>) -> Self {
        Self {
            key: self.key.clone(),
            payload: self.payload.clone(),
            attachment: self.attachment.clone(),
            asker: self.asker,
            way,
            outbox: self.outbox.clone(),
            answers: Rc::default(),
            copies: self.copies.clone(),
        }
    }

    fn send(&self, message: Message) {
        self.answers.set(self.answers.get() + 1);
        self.post(message);
    }

    fn post(&self, message: Message) {
        let (asker, way) = (self.asker, self.way);
        let sent = Sent {
            asker,
            way,
            message,
        };
        self.outbox.borrow_mut().push(sent);
    }
}

impl Drop for Exchange {
    fn drop(&mut self) {
        if Rc::strong_count(&self.copies) == 1 {
            self.post(Message::End);
        }
    }
}

impl Query for Exchange {
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
        attachment: Option<Vec<u8>>,
    ) {
        self.send(Message::Reply(payload, attachment.unwrap_or_default()));
    }

    fn refuse(&self, error: &WireError) {
        self.send(Message::Error(error.encode()));
    }
}

/// A query that a replica received, until it is answered.
pub(crate) struct Received {
    pub(crate) at: Duration,
    pub(crate) answers: Rc<Cell<u32>>,
}

/// How far a replica's process is on its way to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    /// It receives queries, and its liveliness token stands.
    Serving,
    /// The same, and it will drain as soon as it continues, because it was frozen when it was told to end.
    Terminated,
    /// It has withdrawn its token and still receives queries.
    Draining,
    /// It receives no queries.
    Closed,
}

/// A replica's process.
pub(crate) struct Process {
    /// Intake, queue and workers; none while the process does not run.
    pub(crate) machine: Option<Replica<ProcessLibraries, Exchange>>,
    /// Counts the starts, so that what belongs to an earlier process is recognised.
    pub(crate) incarnation: u32,
    pub(crate) frozen: u32,
    pub(crate) slow: u32,
    pub(crate) hostile: u32,
    pub(crate) disorder: u32,
    pub(crate) flood: u32,
    pub(crate) stage: Stage,
    /// Its library file, which it loads when it starts and on command.
    pub(crate) file: File,
    /// The libraries that it serves; those of the last process while none runs.
    pub(crate) libraries: Option<ProcessLibraries>,
    /// Since when it has served each library.
    pub(crate) served: BTreeMap<LibraryId, Duration>,
    /// When the process started, on its own clock.
    pub(crate) started: Duration,
    /// Whether it was commanded to load its file again, and whether it does so at present.
    pub(crate) commanded: bool,
    pub(crate) loading: bool,
    /// How far its clock is ahead.
    pub(crate) clock: Duration,
    /// What happens to it when it continues, because it is frozen.
    pub(crate) deferred: Vec<Event>,
    pub(crate) received: Vec<Received>,
    /// When a worker last began a step, or no request waited.
    pub(crate) progress: Duration,
    /// A recent answer, for replay.
    pub(crate) old_answer: Option<Message>,
    /// Since when it has been sound.
    pub(crate) sound_since: Option<Duration>,
}

impl Process {
    pub(crate) fn new() -> Self {
        Self {
            machine: None,
            incarnation: 0,
            frozen: 0,
            slow: 0,
            hostile: 0,
            disorder: 0,
            flood: 0,
            stage: Stage::Closed,
            file: File::Library(0),
            libraries: None,
            served: BTreeMap::new(),
            started: Duration::ZERO,
            commanded: false,
            loading: false,
            clock: Duration::ZERO,
            deferred: Vec::new(),
            received: Vec::new(),
            progress: Duration::ZERO,
            old_answer: None,
            sound_since: None,
        }
    }

    /// Whether it receives queries.
    pub(crate) fn declared(&self) -> bool {
        self.stage != Stage::Closed
    }

    /// Whether it answers as a replica without fault does.
    pub(crate) fn sound(&self) -> bool {
        self.machine.is_some()
            && self.declared()
            && self.frozen + self.slow + self.hostile + self.disorder + self.flood == 0
    }
}
