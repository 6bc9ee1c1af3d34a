//! Several libraries that are served at a time, and which of them makes room for a new one.

use std::time::Duration;

use egp_engine::unknown_library;
use egp_wire::{Header, LibraryId, Ready, Status, WireError};

use crate::handler::{Handler, LibraryContent};
use crate::sync::atomic::{AtomicU64, Ordering};
use crate::sync::{Arc, PoisonError, RwLock};

/// A library that was asked for within this time is not removed, because a vehicle would lose its service.
const IN_USE: Duration = Duration::from_secs(60);

/// What a loading did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reloaded {
    /// Vehicles that start now get another library than before.
    Changed(LibraryId),
    /// The file holds the library that was served before.
    Same(LibraryId),
}

/// No library can be removed for a new one, because vehicles asked for each of them within the last minute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TableFull {
    /// The largest number of libraries.
    pub limit: usize,
}

/// A library that is served.
struct Served<H> {
    handler: H,
    description: Ready,
    /// When a request that was answered with a reply last asked for it, milliseconds after the start and at least 1; 0 if
    /// none did.
    asked: AtomicU64,
    /// When a reload last found that `ready` described it, in the same unit; 0 if none did. Vehicles that started until then
    /// may ask for it soon.
    described: AtomicU64,
}

impl<H: Handler> Served<H> {
    fn new(handler: H) -> Self {
        Self {
            description: handler.describe(),
            handler,
            asked: AtomicU64::new(0),
            described: AtomicU64::new(0),
        }
    }

    fn id(&self) -> LibraryId {
        self.description.library
    }
}

/// Several libraries, of which each request states one by its hash. The first is the one that `ready` describes.
///
/// The caller gives the time since the start with each call, so that a simulation uses the same code as [`crate::Libraries`].
pub struct LibraryTable<H> {
    limit: usize,
    /// At least one.
    served: RwLock<Arc<[Arc<Served<H>>]>>,
}

/// Memory of one worker for each library that it computed a step with.
pub struct TableWorkspace<W>(Vec<(LibraryId, W)>);

impl<H: Handler> LibraryTable<H> {
    /// A table of the library that `ready` describes and of further ones; one that is given twice is served once. A reload
    /// lets the table have at most `limit` libraries.
    pub fn new(first: H, further: impl IntoIterator<Item = H>, limit: usize) -> Self {
        let mut served = vec![Arc::new(Served::new(first))];
        for handler in further {
            let one = Served::new(handler);
            if served.iter().all(|other| other.id() != one.id()) {
                served.push(Arc::new(one));
            }
        }
        Self {
            limit,
            served: RwLock::new(served.into()),
        }
    }

    /// The hashes of all libraries, in the order of [`Ready`].
    pub fn ids(&self) -> Vec<LibraryId> {
        self.served().iter().map(|one| one.id()).collect()
    }

    /// Lets `ready` describe the library `id` from now on. If it is not served, `load` makes it, given the library that is
    /// described at present. Libraries from before are still served to requests that state them; if there are more than the
    /// limit, the one that was neither asked for nor described for the longest time is removed. The caller begins one
    /// replacement at a time.
    ///
    /// # Errors
    /// The error of `load`, or that of [`TableFull`] if no library can be removed; the same libraries are served then.
    pub fn replace<E: From<TableFull>>(
        &self,
        id: LibraryId,
        now: Duration,
        load: impl FnOnce(&H) -> Result<H, E>,
    ) -> Result<Reloaded, E> {
        let before = self.served();
        before[0].described.store(millis(now), Ordering::Relaxed);
        let known = before.iter().position(|one| one.id() == id);
        let mut after: Vec<_> = before.to_vec();
        match known {
            Some(0) => return Ok(Reloaded::Same(id)),
            Some(index) => after[..=index].rotate_right(1),
            None => {
                let new = Served::new(load(&before[0].handler)?);
                if before.len() >= self.limit {
                    after.remove(self.removable(&before, now)?);
                }
                after.insert(0, Arc::new(new));
            }
        }
        *self.served.write().unwrap_or_else(PoisonError::into_inner) = after.into();
        Ok(Reloaded::Changed(id))
    }

    /// Whether [`Self::replace`] finds a place for a further library.
    pub fn has_room(&self, now: Duration) -> bool {
        let served = self.served();
        served.len() < self.limit || self.removable(&served, now).is_ok()
    }

    /// The index of the library that was neither asked for nor described for the longest time, of those that are not in use.
    fn removable(&self, all: &[Arc<Served<H>>], now: Duration) -> Result<usize, TableFull> {
        let now = millis(now);
        let in_use =
            |asked: u64| asked > 0 && Duration::from_millis(now.saturating_sub(asked)) < IN_USE;
        let idle = all.iter().enumerate().filter_map(|(index, one)| {
            let asked = one.asked.load(Ordering::Relaxed);
            let last = asked.max(one.described.load(Ordering::Relaxed));
            (!in_use(asked)).then_some((last, index))
        });
        idle.min()
            .map(|(_, index)| index)
            .ok_or(TableFull { limit: self.limit })
    }

    fn served(&self) -> Arc<[Arc<Served<H>>]> {
        let served = self.served.read();
        served.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Calls a function with the first library.
    pub(crate) fn first(&self, of: impl FnOnce(&H)) {
        of(&self.served()[0].handler);
    }

    /// The description of the first library, with the hashes of all others.
    pub fn describe(&self) -> Ready {
        let served = self.served();
        let (first, others) = (&served[0], &served[1..]);
        Ready {
            others: others.iter().map(|one| one.id()).collect(),
            ..first.description.clone()
        }
    }

    /// Memory for one more worker.
    ///
    /// # Errors
    /// [`WireError`] if it cannot be made.
    pub fn workspace(&self) -> Result<TableWorkspace<H::Workspace>, WireError> {
        let served = self.served();
        let memory = served
            .iter()
            .map(|one| Ok((one.id(), one.handler.workspace()?)));
        Ok(TableWorkspace(memory.collect::<Result<_, WireError>>()?))
    }

    /// Answers a request with the library that it states, as [`Handler::step`].
    ///
    /// # Errors
    /// [`WireError`] if that library is not served or its step fails.
    pub fn step(
        &self,
        TableWorkspace(memory): &mut TableWorkspace<H::Workspace>,
        request: &[u8],
        reply: &mut Vec<u8>,
        now: Duration,
    ) -> Result<Status, WireError> {
        let asked = Header::decode(request)?.library;
        let served = self.served();
        let Some(one) = served.iter().find(|one| one.id() == asked) else {
            return Err(unknown_library(&self.ids(), &asked));
        };
        if memory.len() > served.len() {
            memory.retain(|(id, _)| served.iter().any(|one| one.id() == *id));
        }
        let known = memory.iter().position(|(id, _)| *id == asked);
        let index = known.unwrap_or(memory.len());
        if known.is_none() {
            memory.push((asked, one.handler.workspace()?));
        }
        let status = one.handler.step(&mut memory[index].1, request, reply)?;
        // A request that is not valid keeps no library in use.
        one.asked.store(millis(now), Ordering::Relaxed);
        Ok(status)
    }

    /// The file of a library that is served.
    pub fn content(&self, library: &LibraryId) -> Option<LibraryContent> {
        let served = self.served();
        let one = served.iter().find(|one| one.id() == *library)?;
        one.handler.content(library)
    }
}

/// Milliseconds since the start, at least 1.
fn millis(now: Duration) -> u64 {
    u64::try_from(now.as_millis()).unwrap_or(u64::MAX - 1) + 1
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_testing::messages;
    use egp_wire::{Code, Request, proto};
    use prost::Message as _;

    use super::*;

    /// A library whose hash is this number 32 times, and whose workspace and reply are the number.
    struct Fake(u8);

    impl Handler for Fake {
        type Workspace = u8;

        fn describe(&self) -> Ready {
            Ready {
                library: [self.0; 32],
                ..messages::ready()
            }
        }

        fn workspace(&self) -> Result<u8, WireError> {
            Ok(self.0)
        }

        fn step(
            &self,
            workspace: &mut u8,
            request: &[u8],
            reply: &mut Vec<u8>,
        ) -> Result<Status, WireError> {
            Request::decode(request)?;
            *reply = vec![self.0, *workspace];
            Ok(Status::Solved)
        }
    }

    struct Tried {
        table: LibraryTable<Fake>,
        memory: TableWorkspace<u8>,
    }

    impl Tried {
        fn new(further: &[u8], limit: usize) -> Self {
            let further = further.iter().map(|&number| Fake(number));
            let table = LibraryTable::new(Fake(1), further, limit);
            let memory = table.workspace().unwrap();
            Self { table, memory }
        }

        fn ids(&self) -> Vec<u8> {
            self.table.ids().iter().map(|id| id[0]).collect()
        }

        /// Replaces the file at a time in seconds: the libraries after it, or the error.
        fn replace(&self, number: u8, at: u64) -> Result<Vec<u8>, TableFull> {
            let now = Duration::from_secs(at);
            let load = |_: &Fake| Ok::<_, TableFull>(Fake(number));
            self.table.replace([number; 32], now, load)?;
            Ok(self.ids())
        }

        /// Asks for a library at a time in seconds: the reply, or the code of the error.
        fn ask(&mut self, number: u8, at: u64) -> Result<Vec<u8>, Code> {
            let mut request = messages::cold_request();
            request.library = [number; 32];
            self.send(&request.encode(), at)
        }

        fn send(&mut self, request: &[u8], at: u64) -> Result<Vec<u8>, Code> {
            let (now, mut reply) = (Duration::from_secs(at), Vec::new());
            let ended = self.table.step(&mut self.memory, request, &mut reply, now);
            ended.map(|_| reply).map_err(|error| error.code)
        }
    }

    #[test]
    fn a_library_that_was_not_asked_for_makes_room_first() {
        let mut tried = Tried::new(&[], 2);
        assert_eq!(tried.ask(1, 1), Ok(vec![1, 1]));
        assert_eq!(tried.replace(2, 2), Ok(vec![2, 1]));
        assert_eq!(tried.replace(3, 3), Ok(vec![3, 1]));
        assert_eq!(tried.ask(2, 4), Err(Code::UnknownLibrary));
        assert_eq!(tried.ask(1, 4), Ok(vec![1, 1]));
        assert_eq!(tried.ask(3, 5), Ok(vec![3, 3]));
    }

    #[test]
    fn the_library_that_was_described_until_now_is_removed_last() {
        let tried = Tried::new(&[], 3);
        assert_eq!(tried.replace(2, 1), Ok(vec![2, 1]));
        assert_eq!(tried.replace(3, 2), Ok(vec![3, 2, 1]));
        assert_eq!(tried.replace(4, 3), Ok(vec![4, 3, 2]));
        assert_eq!(tried.replace(2, 4), Ok(vec![2, 4, 3]));
        assert_eq!(tried.replace(5, 5), Ok(vec![5, 2, 4]));
    }

    #[test]
    fn there_is_room_below_the_limit_or_beside_a_library_that_is_not_in_use() {
        let mut tried = Tried::new(&[], 1);
        let room = |tried: &Tried, at| tried.table.has_room(Duration::from_secs(at));
        assert!(room(&tried, 0));
        assert_eq!(tried.ask(1, 1), Ok(vec![1, 1]));
        assert!(!room(&tried, 60) && room(&tried, 61));
        assert_eq!(tried.replace(2, 60), Err(TableFull { limit: 1 }));
        assert_eq!(tried.replace(2, 61), Ok(vec![2]));
        assert!(room(&Tried::new(&[], 2), 0));
    }

    #[test]
    fn requests_that_are_not_valid_keep_no_library_in_use() {
        let mut tried = Tried::new(&[], 1);
        let header = proto::StepRequest {
            version: 1,
            library: vec![1; 32],
            budget_us: 1000,
            ..proto::StepRequest::default()
        };
        let answer = tried.send(&header.encode_to_vec(), 10);
        assert_eq!(answer, Err(Code::InvalidField));
        assert_eq!(tried.replace(2, 11), Ok(vec![2]));
    }

    #[test]
    fn a_library_makes_room_a_minute_after_it_was_asked_for() {
        let mut tried = Tried::new(&[2, 1], 2);
        assert_eq!(tried.ids(), [1, 2]);
        assert_eq!(
            (tried.ask(1, 0), tried.ask(2, 10)),
            (Ok(vec![1, 1]), Ok(vec![2, 2]))
        );
        let full = Err(TableFull { limit: 2 });
        assert_eq!(tried.replace(3, 59), full);
        assert_eq!(tried.ids(), [1, 2]);
        assert_eq!(tried.replace(3, 60), Ok(vec![3, 2]));
        assert_eq!(tried.ask(3, 61), Ok(vec![3, 3]));
        assert_eq!(tried.replace(4, 69), full);
        // A library that ready described is removed like any other once ready describes another one.
        assert_eq!(tried.replace(2, 69), Ok(vec![2, 3]));
        assert_eq!(tried.replace(4, 70), Ok(vec![4, 3]));
    }

    #[test]
    fn a_library_that_cannot_be_loaded_changes_nothing() {
        let tried = Tried::new(&[], 2);
        let full = TableFull { limit: 0 };
        let load = |_: &Fake| Err(full);
        assert_eq!(
            tried.table.replace([9; 32], Duration::ZERO, load),
            Err(full)
        );
        assert_eq!(tried.ids(), [1]);
        assert!(tried.table.describe().others.is_empty());
    }
}
