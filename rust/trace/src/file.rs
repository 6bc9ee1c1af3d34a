//! The file of spans, which a thread of its own writes.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use thiserror::Error;

use crate::append::{append, append_line};
use crate::counts::Counts;
use crate::line::{Resource, line};
use crate::span::Span;

/// Time between two looks at what is to be written. No event wakes the thread, because that would cost a control step more
/// than all else that is done for its spans.
const PERIOD: Duration = Duration::from_millis(200);
/// Steps whose spans may wait, which is what 20 000 requests a second bring within a period. Their spans take some 10 MB.
const CAPACITY: usize = 4096;
/// Largest number of spans of a line, unless one step alone has more. A line then has some 150 kB; the Collector cuts lines of
/// more than 1 MiB.
const LINE_SPANS: usize = 256;

/// Why traces cannot be written.
#[derive(Debug, Error)]
pub enum TraceError {
    /// The file cannot be opened.
    #[error("cannot write traces to {path}: {source}; choose another file for `traces`")]
    Open {
        /// The file.
        path: String,
        /// The error of the system.
        source: io::Error,
    },
    /// The system could not start a thread.
    #[error("cannot start the thread that writes traces: {0}")]
    Thread(io::Error),
}

/// A file to which spans are appended. It must be the only writer of the file.
///
/// [`TraceFile::add`] never waits: a thread writes what has come, five times a second and when the `TraceFile` is dropped. It
/// opens the file anew each time, so that a file that was moved away is followed by a new one. An error of the system is
/// logged, and its spans are lost; the spans after it are tried again.
pub struct TraceFile {
    spans: SyncSender<Vec<Span>>,
    counts: Counts,
    writing: Option<(Sender<()>, JoinHandle<()>)>,
}

impl TraceFile {
    /// Opens a file, which is made if it does not exist, and starts to write.
    ///
    /// # Errors
    /// [`TraceError`] if the file cannot be opened for writing, or the thread cannot be started.
    pub fn open(path: &Path, resource: Resource) -> Result<Self, TraceError> {
        append(path).map_err(|source| TraceError::Open {
            path: path.display().to_string(),
            source,
        })?;
        let (spans, waiting) = sync_channel(CAPACITY);
        let (stop, stopped) = channel();
        let counts = Counts::default();
        let writer = Writer {
            path: path.to_owned(),
            resource,
            waiting,
            counts: counts.clone(),
            failing: false,
        };
        let thread = thread::Builder::new().name("egp-traces".to_owned());
        let thread = thread
            .spawn(move || writer.run(&stopped))
            .map_err(TraceError::Thread)?;
        Ok(Self {
            spans,
            counts,
            writing: Some((stop, thread)),
        })
    }

    /// Finds out whether [`TraceFile::open`] could open the file. A file that did not exist does not exist afterwards.
    ///
    /// # Errors
    /// [`TraceError::Open`].
    pub fn check(path: &Path) -> Result<(), TraceError> {
        let existed = path.exists();
        let opened = append(path).and_then(|_| {
            if existed {
                Ok(())
            } else {
                // A link to a file that did not exist stays.
                fs::remove_file(fs::canonicalize(path)?)
            }
        });
        opened.map_err(|source| TraceError::Open {
            path: path.display().to_string(),
            source,
        })
    }

    /// Hands over the spans of one step. They are dropped and counted if too many wait.
    pub fn add(&self, spans: Vec<Span>) {
        let count = spans.len() as u64;
        if self.spans.try_send(spans).is_err() {
            self.counts.0.dropped.fetch_add(count, Ordering::Relaxed);
        }
    }

    /// What became of the spans so far.
    pub fn counts(&self) -> Counts {
        self.counts.clone()
    }
}

impl Drop for TraceFile {
    /// Waits until all spans are written.
    fn drop(&mut self) {
        if let Some((stop, thread)) = self.writing.take() {
            drop(stop);
            // The thread has no code that panics; without it nothing is left to be done.
            let _ = thread.join();
        }
    }
}

/// The thread's side of a [`TraceFile`].
struct Writer {
    path: PathBuf,
    resource: Resource,
    waiting: Receiver<Vec<Span>>,
    counts: Counts,
    /// Whether the last line could not be written.
    failing: bool,
}

impl Writer {
    fn run(mut self, stopped: &Receiver<()>) {
        while stopped.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
            self.write_waiting();
        }
        self.write_waiting();
    }

    /// Writes all that waits. The spans of a step are in one line.
    fn write_waiting(&mut self) {
        let mut spans = Vec::new();
        while let Ok(step) = self.waiting.try_recv() {
            if spans.len() + step.len() > LINE_SPANS {
                self.write(&spans);
                spans.clear();
            }
            spans.extend(step);
        }
        self.write(&spans);
    }

    /// Appends a line with these spans to the file; without spans it does nothing.
    fn write(&mut self, spans: &[Span]) {
        if spans.is_empty() {
            return;
        }
        let line = line(&self.resource, spans).map_err(io::Error::from);
        let written = line.and_then(|line| append_line(&self.path, &line));
        let count = spans.len() as u64;
        match &written {
            Ok(()) => {
                self.counts.0.written.fetch_add(count, Ordering::Relaxed);
            }
            Err(error) => self.counts.fail(count, error.to_string()),
        }
        let path = self.path.display();
        match (&written, self.failing) {
            (Err(error), false) => tracing::warn!(%path, %error, "traces are not written"),
            (Ok(()), true) => tracing::info!(%path, "traces are written again"),
            _ => {}
        }
        self.failing = written.is_err();
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use serde_json::Value;

    use super::*;
    use crate::{Kind, StepIds, name};

    /// A folder that is removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new() -> Self {
            static NUMBER: AtomicUsize = AtomicUsize::new(0);
            let number = NUMBER.fetch_add(1, Ordering::Relaxed);
            let name = format!("egp-trace-{}-{number}", std::process::id());
            let path = std::env::temp_dir().join(name);
            fs::create_dir(&path).unwrap();
            Self(path)
        }

        fn file(&self) -> PathBuf {
            self.0.join("traces.jsonl")
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            fs::remove_dir_all(&self.0).unwrap();
        }
    }

    fn resource() -> Resource {
        Resource {
            service: "egp-server",
            instance: "main".to_owned(),
        }
    }

    fn span(number: u64) -> Span {
        let ids = StepIds::new("depot", "car", &number.to_le_bytes());
        Span::new(&ids, name::STEP, Kind::Internal, number..number + 1)
    }

    /// The start times of the spans in a file, by its lines.
    fn starts(path: &Path) -> Vec<Vec<String>> {
        let text = fs::read_to_string(path).unwrap();
        assert!(text.is_empty() || text.ends_with('\n'));
        let start = |span: &Value| span["startTimeUnixNano"].as_str().unwrap().to_owned();
        let read = |line: &str| {
            let data: Value = serde_json::from_str(line).unwrap();
            let group = &data["resourceSpans"][0];
            let instance = &group["resource"]["attributes"][1];
            assert_eq!(instance["key"], "service.instance.id");
            assert_eq!(instance["value"]["stringValue"], "main");
            let spans = group["scopeSpans"][0]["spans"].as_array().unwrap();
            spans.iter().map(start).collect()
        };
        text.lines().map(read).collect()
    }

    fn wait_until(condition: impl Fn() -> bool) {
        for _ in 0..6000 {
            if condition() {
                return;
            }
            thread::sleep(Duration::from_millis(10));
        }
        unreachable!("waited for a minute");
    }

    #[test]
    fn spans_are_appended_within_a_second_and_at_the_end() {
        let folder = Folder::new();
        let file = TraceFile::open(&folder.file(), resource()).unwrap();
        file.add(vec![span(1), span(2)]);
        wait_until(|| file.counts().written() == 2);
        assert_eq!(starts(&folder.file()), [["1", "2"]]);
        file.add(vec![span(3)]);
        let counts = file.counts();
        drop(file);
        assert_eq!(starts(&folder.file()).concat(), ["1", "2", "3"]);
        assert_eq!(
            (counts.written(), counts.dropped(), counts.failed()),
            (3, 0, 0)
        );
        drop(TraceFile::open(&folder.file(), resource()).unwrap());
        assert_eq!(starts(&folder.file()).concat().len(), 3);
    }

    #[test]
    fn lines_are_bounded_and_what_is_too_much_is_dropped() {
        let folder = Folder::new();
        let file = TraceFile::open(&folder.file(), resource()).unwrap();
        // The bound of a line is no multiple of the spans of a step.
        let (steps, each) = (3 * CAPACITY as u64, 3);
        for _ in 0..steps {
            file.add([1, 2, 3].map(span).to_vec());
        }
        let counts = file.counts();
        drop(file);
        assert!(counts.written() >= CAPACITY as u64 * each);
        assert_eq!(counts.written() + counts.dropped(), steps * each);
        let lines = starts(&folder.file());
        assert!(lines.iter().all(|line| line.len() <= LINE_SPANS));
        assert!(lines.iter().any(|line| line.len() == LINE_SPANS - 1));
        let whole = |line: &Vec<String>| line.chunks(3).all(|step| step == ["1", "2", "3"]);
        assert!(lines.iter().all(whole));
        assert_eq!(lines.concat().len() as u64, counts.written());
    }

    #[test]
    fn a_file_that_was_moved_away_is_followed_by_a_new_one() {
        let folder = Folder::new();
        let file = TraceFile::open(&folder.file(), resource()).unwrap();
        file.add(vec![span(1)]);
        wait_until(|| file.counts().written() == 1);
        fs::rename(folder.file(), folder.0.join("old.jsonl")).unwrap();
        file.add(vec![span(2)]);
        drop(file);
        assert_eq!(starts(&folder.0.join("old.jsonl")), [["1"]]);
        assert_eq!(starts(&folder.file()), [["2"]]);
    }

    #[test]
    fn a_folder_that_is_gone_costs_spans_and_nothing_else() {
        let folder = Folder::new();
        let inner = folder.0.join("inner");
        fs::create_dir(&inner).unwrap();
        let path = inner.join("traces.jsonl");
        let file = TraceFile::open(&path, resource()).unwrap();
        fs::remove_dir_all(&inner).unwrap();
        file.add(vec![span(1)]);
        wait_until(|| file.counts().failed() == 1);
        let reason = file.counts().last_error();
        assert!(reason.is_some_and(|reason| reason.contains("No such file")));
        fs::create_dir(&inner).unwrap();
        file.add(vec![span(2)]);
        drop(file);
        assert_eq!(starts(&path), [["2"]]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_costs_spans_and_nothing_else() {
        let file = TraceFile::open(Path::new("/dev/full"), resource()).unwrap();
        file.add(vec![span(1)]);
        wait_until(|| file.counts().failed() == 1);
        assert_eq!(file.counts().written(), 0);
    }

    #[test]
    fn a_check_leaves_a_link_without_its_file_as_it_is() {
        let folder = Folder::new();
        let target = folder.0.join("target.jsonl");
        std::os::unix::fs::symlink(&target, folder.file()).unwrap();
        TraceFile::check(&folder.file()).unwrap();
        assert!(folder.file().is_symlink() && !target.exists());
        drop(TraceFile::open(&folder.file(), resource()).unwrap());
        TraceFile::check(&folder.file()).unwrap();
        assert!(folder.file().is_symlink() && target.exists());
    }

    #[test]
    fn a_pipe_is_an_error_and_nobody_waits_for_its_reader() {
        let folder = Folder::new();
        let made = std::process::Command::new("mkfifo")
            .arg(folder.file())
            .status();
        assert!(made.unwrap().success());
        for error in [
            TraceFile::check(&folder.file()).err(),
            TraceFile::open(&folder.file(), resource()).err(),
        ] {
            let message = error.unwrap().to_string();
            assert!(message.contains("got a pipe"), "{message}");
        }
    }

    #[test]
    fn a_file_that_cannot_be_written_is_named() {
        let folder = Folder::new();
        let missing = folder.0.join("missing").join("traces.jsonl");
        for error in [
            TraceFile::open(&missing, resource()).err(),
            TraceFile::check(&missing).err(),
            TraceFile::check(&folder.0).err(),
        ] {
            let message = error.unwrap().to_string();
            assert!(message.contains("egp-trace-"), "{message}");
            assert!(message.contains("`traces`"), "{message}");
        }
        TraceFile::check(&folder.file()).unwrap();
        assert!(!folder.file().exists());
        fs::write(folder.file(), "kept").unwrap();
        TraceFile::check(&folder.file()).unwrap();
        assert_eq!(fs::read_to_string(folder.file()).unwrap(), "kept");
    }
}
