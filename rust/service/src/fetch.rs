//! Fetching a library by its SHA-256 from any replica that has it.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use egp_core::library::{self, MAX_FILE_BYTES};
use egp_engine::read_library;
use egp_wire::keys::Name;
use egp_wire::{Code, LIBRARY_PART_BYTES, LibraryFile, LibraryId};
use egp_wire::{WireError, library_keys};

use crate::config::ServiceConfig;
use crate::configuration::{asking, configuration};
use crate::fetch_error::{Failures, FetchError, FetchFailure};
use crate::network::Network;
use crate::query::Answer;
use crate::signature::{NewLibrary, Signature, Signers, Unwritten, check_replaceable};

/// How long all replicas may take to say whether they have a library.
const QUESTION: Duration = Duration::from_secs(1);
/// How long a replica may take to answer a question for a part.
const PART: Duration = Duration::from_secs(2);
/// How often a replica is asked for a part that it does not answer.
const ATTEMPTS: u32 = 3;
/// Longest time of a transfer of few bytes. Those of a large library prolong it, as [`SLOWEST`] says.
const TRANSFER: Duration = Duration::from_secs(10);
/// Number of bytes that prolong a transfer by a second.
const SLOWEST: u64 = 4 << 20;
/// Time between two rounds of questions to which nobody answered, and between two looks whether to stop.
const POLL: Duration = Duration::from_millis(50);
/// Time between two rounds of questions if somebody answered.
const AGAIN: Duration = Duration::from_millis(500);
/// How long another replica may take to appear after all others have given an answer that asking again does not change.
const LAST: Duration = Duration::from_secs(1);

/// A library that is to be in a file.
pub struct Wanted<'a> {
    /// Its SHA-256.
    pub id: LibraryId,
    /// The file. Its signature is in the file with `.sig` behind the name.
    pub file: &'a Path,
    /// File of the public keys of those who may sign libraries; without it no signature is demanded.
    pub keys: Option<&'a Path>,
}

/// Where a library came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fetched {
    /// The file had it already.
    Already,
    /// This replica sent it.
    From(Name),
}

impl Wanted<'_> {
    /// Fetches the library unless the file holds it. Replicas are asked until one of them gave it, or `patience` has passed, or
    /// for about a second all that announce themselves have answered that they do not have it or sent what cannot be used. A
    /// transfer that has begun then is completed. Hash, signature and the library itself are checked before the file is
    /// replaced. `stopped` is called at least once a second and tells whether to give up.
    ///
    /// `network` is used with its zenoh settings only: the session connects as a service with it would, and does not listen.
    ///
    /// # Errors
    /// [`FetchError`].
    pub fn fetch(
        &self,
        network: &ServiceConfig,
        patience: Duration,
        stopped: &mut dyn FnMut() -> bool,
    ) -> Result<Fetched, FetchError> {
        let signers = self.keys.map(Signers::load).transpose()?;
        if self.is_there(signers.as_ref()) {
            return Ok(Fetched::Already);
        }
        check_replaceable(self.file).map_err(unwritten)?;
        let (library, file) = (self.hex(), self.file.display());
        tracing::info!(library, %file, "asking replicas for the library");
        let (config, _) = configuration(network.zenoh_file.as_deref(), &network.zenoh, None)?;
        let mut fetching = Fetching {
            wanted: self,
            signers,
            network: Network::open(asking(config, patience)?, patience, stopped)?,
            failures: Failures::default(),
            stopped,
        };
        let fetched = fetching.rounds(patience);
        fetching.network.close();
        fetched
    }

    /// Errors unless the file holds the library, without asking anybody.
    ///
    /// # Errors
    /// [`FetchError::Absent`], or [`FetchError::Keys`].
    pub(crate) fn check(&self) -> Result<(), FetchError> {
        let signers = self.keys.map(Signers::load).transpose()?;
        if self.is_there(signers.as_ref()) {
            return Ok(());
        }
        Err(FetchError::Absent {
            path: self.file.display().to_string(),
            library: self.hex(),
        })
    }

    fn is_there(&self, signers: Option<&Signers>) -> bool {
        read_library(self.file).is_ok_and(|bytes| {
            let signed = |signers: &Signers| signers.check(self.file, &bytes).is_ok();
            library::hash(&bytes) == self.id && signers.is_none_or(signed)
        })
    }

    fn hex(&self) -> String {
        library::hex(&self.id)
    }

    /// Replaces the file and its signature.
    fn write(&self, bytes: &[u8], signature: Option<Signature>) -> Result<(), FetchError> {
        let written = NewLibrary::write(self.file, bytes, signature);
        let replaced = written.and_then(NewLibrary::replace);
        replaced.map_err(unwritten)
    }
}

fn unwritten((path, source): Unwritten) -> FetchError {
    FetchError::Write {
        path: path.display().to_string(),
        source,
    }
}

/// A session that fetches one library.
struct Fetching<'a> {
    wanted: &'a Wanted<'a>,
    signers: Option<Signers>,
    network: Network,
    failures: Failures,
    stopped: &'a mut dyn FnMut() -> bool,
}

impl Fetching<'_> {
    /// Asks all replicas for the library until one gave it, the patience ends, or none is left that may give it.
    fn rounds(&mut self, patience: Duration) -> Result<Fetched, FetchError> {
        let (begun, key) = (Instant::now(), library_keys::any_library(&self.wanted.id));
        // Since when each round ended with answers that asking again does not change.
        let mut refused: Option<Instant> = None;
        loop {
            let answers = self.network.ask(&key, QUESTION)?;
            let (mut all, mut refusals) = (0, 0);
            while let Some(answer) = self.next(&answers)? {
                match self.take(answer)? {
                    Taken::Library(replica) => return Ok(Fetched::From(replica)),
                    Taken::Nothing { is_final } => {
                        all += 1;
                        refusals += usize::from(is_final);
                    }
                }
            }
            let all_answered = self.network.live().is_some_and(|live| all >= live);
            let is_refused = refusals == all && all_answered;
            refused = refused.or(Some(Instant::now())).filter(|_| is_refused);
            if begun.elapsed() > patience || refused.is_some_and(|since| since.elapsed() >= LAST) {
                break;
            }
            self.pause(if all > 0 { AGAIN } else { POLL })?;
        }
        let library = self.wanted.hex();
        let failures = std::mem::take(&mut self.failures).told();
        if failures.is_empty() {
            let seconds = begun.elapsed().as_secs_f64();
            return Err(FetchError::NoAnswer { library, seconds });
        }
        Err(FetchError::Failed { library, failures })
    }

    /// Waits for this time.
    fn pause(&mut self, time: Duration) -> Result<(), FetchError> {
        let end = Instant::now() + time;
        while Instant::now() < end {
            self.look()?;
            thread::sleep(POLL);
        }
        Ok(())
    }

    /// Errors if it is to stop.
    fn look(&mut self) -> Result<(), FetchError> {
        if (self.stopped)() {
            let library = self.wanted.hex();
            return Err(FetchError::Stopped { library });
        }
        Ok(())
    }

    /// The next answer, or none after the last one.
    fn next(&mut self, answers: &Receiver<Answer>) -> Result<Option<Answer>, FetchError> {
        loop {
            self.look()?;
            match answers.recv_timeout(POLL) {
                Ok(answer) => return Ok(Some(answer)),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
            }
        }
    }

    /// Fetches from the replica of an answer, and writes the library.
    fn take(&mut self, Answer { key, content }: Answer) -> Result<Taken, FetchError> {
        let replica = key.as_deref().and_then(library_keys::replica_of_library);
        let (replica, failure) = match (content, replica) {
            (Err(error), replica) => (replica, error.into()),
            // A key that is no replica's cannot be asked for parts.
            (Ok(_), None) => return Ok(Taken::Nothing { is_final: true }),
            (Ok(_), Some(replica)) if self.failures.is_given_up(&replica) => {
                return Ok(Taken::Nothing { is_final: true });
            }
            (Ok(message), Some(replica)) => match self.transfer(&replica, &message)? {
                Ok((bytes, signature)) => {
                    self.wanted.write(&bytes, signature)?;
                    return Ok(Taken::Library(replica));
                }
                Err(failure) => (Some(replica), failure),
            },
        };
        let is_final = failure.is_final();
        self.failures.note(replica, failure);
        Ok(Taken::Nothing { is_final })
    }

    /// Fetches all parts from a replica, and checks them; `message` is its answer.
    fn transfer(&mut self, replica: &Name, message: &[u8]) -> Result<Transferred, FetchError> {
        let file = match LibraryFile::decode(message) {
            Ok(file) => file,
            Err(invalid) => return Ok(Err(invalid.into())),
        };
        let size = usize::try_from(file.bytes).ok();
        let size = size.filter(|size| *size <= MAX_FILE_BYTES);
        let (Some(size), Ok(parts)) = (size, u32::try_from(file.parts())) else {
            return Ok(Err(FetchFailure::TooLarge { bytes: file.bytes }));
        };
        let begun = Instant::now();
        let late = begun + TRANSFER + Duration::from_secs(file.bytes / SLOWEST);
        // Memory grows with what comes, not with what the replica states.
        let mut bytes = Vec::new();
        for part in 0..parts {
            let key = library_keys::library_part(replica, &self.wanted.id, part);
            let expected = LIBRARY_PART_BYTES.min(size - bytes.len());
            match self.part(&key, late)? {
                Ok(Some(content)) if content.len() == expected => bytes.extend(content),
                Ok(Some(content)) => {
                    let actual = content.len();
                    return Ok(Err(FetchFailure::Part {
                        part,
                        expected,
                        actual,
                    }));
                }
                Ok(None) if Instant::now() > late => {
                    return Ok(Err(FetchFailure::Slow {
                        bytes: bytes.len(),
                        seconds: begun.elapsed().as_secs_f64(),
                    }));
                }
                Ok(None) => return Ok(Err(FetchFailure::Gone { part, parts })),
                Err(error) => return Ok(Err(error.into())),
            }
        }
        Ok(self
            .accept(&bytes, file.signature)
            .map(|()| (bytes, file.signature)))
    }

    /// Asks for a part. Returns its content, the replica's error, or none if no answer came.
    fn part(
        &mut self,
        key: &str,
        late: Instant,
    ) -> Result<Result<Option<Vec<u8>>, WireError>, FetchError> {
        let mut left = ATTEMPTS;
        while left > 0 && Instant::now() <= late {
            let answers = self.network.ask(key, PART)?;
            match self.next(&answers)?.map(|answer| answer.content) {
                Some(Err(error)) if error.code == Code::Overloaded => {
                    let wait = Duration::from_micros(error.retry_after_us.into());
                    thread::sleep(wait.clamp(POLL / 10, POLL));
                }
                Some(content) => return Ok(content.map(Some)),
                None => {
                    left -= 1;
                    thread::sleep(2 * POLL);
                }
            }
        }
        Ok(Ok(None))
    }

    /// Checks hash, signature, and the library itself.
    fn accept(&self, bytes: &[u8], signature: Option<Signature>) -> Result<(), FetchFailure> {
        let actual = library::hash(bytes);
        if actual != self.wanted.id {
            let actual = library::hex(&actual);
            return Err(FetchFailure::Hash { actual });
        }
        if let Some(signers) = &self.signers {
            let signature = signature.ok_or(FetchFailure::Unsigned)?;
            let name = PathBuf::from(format!("library {}", self.wanted.hex()));
            signers.accept(&name, bytes, &signature)?;
        }
        egp_core::Library::from_bytes(bytes)?;
        Ok(())
    }
}

/// What came of an answer.
enum Taken {
    /// This replica gave the library.
    Library(Name),
    /// Its replica did not give the library, for good if asking again does not change that.
    Nothing { is_final: bool },
}

/// What a replica sent after its check, or why it is not used.
type Transferred = Result<(Vec<u8>, Option<Signature>), FetchFailure>;
