//! The thread that loads the library file again, on command and when the file changes.

use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

use egp_wire::LibraryId;

use crate::libraries::{Libraries, ReloadError};
use crate::library_table::Reloaded;
use crate::sync::Arc;
use crate::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender, TrySendError};
use crate::sync::thread::{self, JoinHandle};

/// How a reload ended, and all libraries that are served now.
pub(crate) type Outcome = Result<(Reloaded, Vec<LibraryId>), ReloadError>;

/// What tells one content of a file from another without reading it. Programs can set the time of modification, as those that
/// unpack an archive do; they cannot set the inode and the time of the last change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stamp {
    modified: SystemTime,
    length: u64,
    inode: u64,
    /// Time of the last change of content, name or rights, s and ns.
    changed: (i64, i64),
}

/// A reloader that was not started.
pub(crate) struct Reloader {
    libraries: Arc<Libraries>,
    watch: Option<Duration>,
    /// Reads the keys of the vehicles again; it is called on each command, before the library is loaded.
    read_keys: Option<Box<dyn Fn() + Send>>,
    /// The file as it was loaded last.
    stamp: Option<Stamp>,
    /// The last loading, if it failed.
    failed: Option<Failed>,
}

/// A loading that failed. The watch tries it again without a change of the file, and tells log and metrics when the reason
/// changes.
struct Failed {
    at: Instant,
    why: String,
    /// Whether it may succeed without a change of the file: what it lacked, such as a signature or room for a further library,
    /// may be there by then. A file that was read and is no library that fits the settings stays so, and loading it takes
    /// cores from the steps.
    may_heal: bool,
    /// It failed only because there was no room.
    full: bool,
}

/// Time after which such a loading is tried again.
const RETRY: Duration = Duration::from_secs(5);

/// The running thread, which ends when this value is dropped; a loading that has begun is completed first.
pub(crate) struct Running {
    command: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Reloader {
    /// Reloads on command, and when the file changed since the last look; looks are `watch` apart. `stamp` was taken before
    /// the libraries were loaded, so that a change since then is seen.
    pub(crate) fn new(
        libraries: Arc<Libraries>,
        watch: Option<Duration>,
        stamp: Option<Stamp>,
    ) -> Self {
        Self {
            libraries,
            watch,
            read_keys: None,
            stamp,
            failed: None,
        }
    }

    /// Calls `read_keys` on each command, before the library is loaded, so that the thread that commands waits for no file.
    pub(crate) fn with_keys(mut self, read_keys: impl Fn() + Send + 'static) -> Self {
        self.read_keys = Some(Box::new(read_keys));
        self
    }

    /// Starts the thread, which hands each outcome to `note`.
    pub(crate) fn start(self, note: impl Fn(Outcome) + Send + 'static) -> std::io::Result<Running> {
        self.start_with(Libraries::reload, note)
    }

    /// As [`Reloader::start`], with this function that loads the file. A panic in it becomes an error.
    fn start_with(
        mut self,
        reload: impl Fn(&Libraries) -> Result<Reloaded, ReloadError> + Send + 'static,
        note: impl Fn(Outcome) + Send + 'static,
    ) -> std::io::Result<Running> {
        // Commands that come while one waits are the same command.
        let (command, commands) = mpsc::sync_channel(1);
        let thread = thread::Builder::new().name("egp-library".to_owned());
        let thread = thread.spawn(move || {
            while let Some(commanded) = self.wait(&commands) {
                let now = stamp(self.libraries.file());
                let changed = commanded || now != self.stamp;
                let again = self.failed.as_ref().is_some_and(|failed| {
                    // Without room all the work of loading would be in vain.
                    let has_room = !failed.full || self.libraries.has_room();
                    failed.may_heal && failed.at.elapsed() > RETRY && has_room
                });
                if changed || again {
                    // A change during the loading is seen at the next look.
                    self.stamp = now;
                    let reloaded = catch_unwind(AssertUnwindSafe(|| {
                        if let Some(read) = self.read_keys.as_ref().filter(|_| commanded) {
                            read();
                        }
                        reload(&self.libraries)
                    }));
                    let reloaded = reloaded.unwrap_or(Err(ReloadError::Defect));
                    let before = self.failed.take().map(|failed| failed.why);
                    self.failed = reloaded.as_ref().err().map(|error| Failed {
                        at: Instant::now(),
                        why: error.to_string(),
                        may_heal: error.may_heal(),
                        full: matches!(error, ReloadError::Full { .. }),
                    });
                    if changed || self.failed.as_ref().map(|failed| &failed.why) != before.as_ref()
                    {
                        note(reloaded.map(|reloaded| (reloaded, self.libraries.ids())));
                    }
                }
            }
        })?;
        Ok(Running {
            command: Some(command),
            thread: Some(thread),
        })
    }

    /// Waits for a command or the next look: whether it was a command, or none once the thread is to end.
    fn wait(&self, commands: &Receiver<()>) -> Option<bool> {
        let Some(period) = self.watch else {
            return commands.recv().ok().map(|()| true);
        };
        match commands.recv_timeout(period) {
            Ok(()) => Some(true),
            Err(RecvTimeoutError::Timeout) => Some(false),
            Err(RecvTimeoutError::Disconnected) => None,
        }
    }
}

impl Running {
    /// Commands a reload and returns at once.
    ///
    /// # Errors
    /// [`ReloadError::Ended`] if the thread has ended, which only a panic can cause.
    pub(crate) fn reload(&self) -> Result<(), ReloadError> {
        match self.command.as_ref().map(|command| command.try_send(())) {
            // A full channel holds a command that has not begun.
            Some(Ok(()) | Err(TrySendError::Full(()))) => Ok(()),
            Some(Err(TrySendError::Disconnected(()))) | None => Err(ReloadError::Ended),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.command = None;
        if self
            .thread
            .take()
            .is_some_and(|thread| thread.join().is_err())
        {
            tracing::error!("the thread that loads libraries ended by a panic");
        }
    }
}

/// The stamp of a file; none if it is not there.
pub(crate) fn stamp(file: &Path) -> Option<Stamp> {
    let metadata = fs::metadata(file).ok()?;
    Some(Stamp {
        modified: metadata.modified().ok()?,
        length: metadata.len(),
        inode: metadata.ino(),
        changed: (metadata.ctime(), metadata.ctime_nsec()),
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_core::{Kernel, library};
    use egp_testing::libraries;

    use super::*;
    use crate::config::ServiceConfig;
    use crate::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn a_file_of_the_same_length_and_time_is_another_one() {
        let folder = std::env::temp_dir().join(format!("egp-stamp-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let (file, beside) = (folder.join("library"), folder.join("beside"));
        let write = |path: &Path| {
            fs::write(path, "content").unwrap();
            let written = fs::File::options().write(true).open(path).unwrap();
            written.set_modified(SystemTime::UNIX_EPOCH).unwrap();
        };
        write(&file);
        let before = stamp(&file);
        assert_eq!(stamp(&file), before);
        write(&beside);
        fs::rename(&beside, &file).unwrap();
        assert_ne!(stamp(&file), before);
        fs::remove_dir_all(&folder).unwrap();
    }

    /// Writes a library with this number of points.
    fn write(file: &Path, points: usize) {
        let spec = libraries::spec(Kernel::Rbf, &[0.5], points, 3);
        fs::write(file, library::encode(&spec).unwrap()).unwrap();
    }

    #[test]
    fn a_loading_that_panics_is_an_error_and_the_next_one_is_tried() {
        let file = std::env::temp_dir().join(format!("egp-reload-panic-{}", std::process::id()));
        write(&file, 20);
        let libraries = Arc::new(Libraries::load(&ServiceConfig::new(file.clone())).unwrap());
        let (told, outcomes) = mpsc::sync_channel(8);
        let begun = AtomicBool::new(false);
        let reload = move |libraries: &Libraries| {
            assert!(begun.swap(true, Ordering::Relaxed), "the first one panics");
            libraries.reload()
        };
        let running = Reloader::new(libraries, None, None)
            .start_with(reload, move |outcome| told.send(outcome).unwrap())
            .unwrap();
        let next = || {
            running.reload().unwrap();
            outcomes.recv_timeout(Duration::from_secs(60)).unwrap()
        };
        assert!(matches!(next(), Err(ReloadError::Defect)));
        assert!(matches!(next(), Ok((Reloaded::Same(_), _))));
        fs::remove_file(&file).unwrap();
    }

    #[test]
    fn only_what_may_heal_is_tried_again() {
        let file = std::env::temp_dir().join(format!("egp-reload-heal-{}", std::process::id()));
        write(&file, 20);
        let libraries = Libraries::load(&ServiceConfig::new(file.clone())).unwrap();
        fs::write(&file, "no library").unwrap();
        assert!(!libraries.reload().unwrap_err().may_heal());
        fs::remove_file(&file).unwrap();
        assert!(libraries.reload().unwrap_err().may_heal());
    }

    #[test]
    fn a_command_to_a_thread_that_has_ended_is_an_error() {
        let (command, commands) = mpsc::sync_channel(1);
        let running = Running {
            command: Some(command),
            thread: None,
        };
        assert!(running.reload().is_ok() && running.reload().is_ok());
        drop(commands);
        assert!(matches!(running.reload(), Err(ReloadError::Ended)));
    }

    #[test]
    fn a_file_that_was_replaced_after_the_stamp_is_loaded_again() {
        let folder = std::env::temp_dir().join(format!("egp-reloader-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let file = folder.join("library.safetensors");
        let write = |points| write(&file, points);
        write(20);
        let before = stamp(&file);
        write(30);
        let libraries = Arc::new(Libraries::load(&ServiceConfig::new(file.clone())).unwrap());
        for (taken, reloads) in [(before, true), (stamp(&file), false)] {
            let look = Some(Duration::from_millis(5));
            let (told, outcomes) = mpsc::sync_channel(8);
            let reloader = Reloader::new(libraries.clone(), look, taken);
            let running = reloader.start(move |outcome| told.send(outcome.is_ok()).unwrap());
            let outcome =
                outcomes.recv_timeout(Duration::from_millis(if reloads { 5000 } else { 200 }));
            assert_eq!(outcome.ok(), reloads.then_some(true));
            drop(running.unwrap());
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
