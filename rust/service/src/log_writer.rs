//! Lines for the log, which a thread of its own writes: a program that stops reading the log does not block the service.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use prometheus_client::metrics::counter::Counter;
use tracing_subscriber::fmt::MakeWriter;

/// Lines that wait at most. A further line is lost.
const WAITING: usize = 4096;

#[derive(Default)]
struct Queue {
    lines: VecDeque<Vec<u8>>,
    /// Whether a line is being written.
    writing: bool,
}

#[derive(Default)]
struct Lines {
    queue: Mutex<Queue>,
    /// A line has come.
    come: Condvar,
    /// A line was written.
    written: Condvar,
    lost: Counter,
}

impl Lines {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes each line that comes to `output`. A line that cannot be written is lost.
    fn write(&self, mut output: impl Write) {
        loop {
            let queue = self
                .come
                .wait_while(self.lock(), |queue| queue.lines.is_empty());
            let mut queue = queue.unwrap_or_else(PoisonError::into_inner);
            let line = queue.lines.pop_front().unwrap_or_default();
            queue.writing = true;
            drop(queue);
            let failed = output.write_all(&line).is_err();
            self.lost.inc_by(u64::from(failed));
            self.lock().writing = false;
            self.written.notify_all();
        }
    }
}

/// Takes lines without waiting.
#[derive(Clone)]
pub(crate) struct LogWriter(Arc<Lines>);

impl LogWriter {
    /// Starts the thread that writes to `output`.
    ///
    /// # Errors
    /// If the system cannot start the thread.
    pub(crate) fn start(output: impl Write + Send + 'static) -> io::Result<Self> {
        let lines = Arc::new(Lines::default());
        let writer = Self(lines.clone());
        let thread = thread::Builder::new().name("egp-log".to_owned());
        thread.spawn(move || lines.write(output))?;
        Ok(writer)
    }

    /// Waits until all lines are written, for `patience` at most.
    pub(crate) fn flush(&self, patience: Duration) {
        let waits = |queue: &mut Queue| queue.writing || !queue.lines.is_empty();
        // Lines that are still not written are lost.
        let _ = (self.0.written).wait_timeout_while(self.0.lock(), patience, waits);
    }

    /// Counts the lines that are lost.
    pub(crate) fn lost(&self) -> Counter {
        self.0.lost.clone()
    }
}

impl Write for LogWriter {
    /// Takes one line: tracing-subscriber writes each event by one call.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let mut queue = self.0.lock();
        if queue.lines.len() < WAITING {
            queue.lines.push_back(line.to_vec());
        } else {
            self.0.lost.inc();
        }
        drop(queue);
        self.0.come.notify_one();
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl MakeWriter<'_> for LogWriter {
    type Writer = Self;

    fn make_writer(&self) -> Self {
        self.clone()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::io::Read as _;
    use std::time::Instant;

    use super::*;

    #[test]
    fn lines_are_written_in_order_before_the_end() {
        let (mut reader, output) = io::pipe().unwrap();
        let mut writer = LogWriter::start(output).unwrap();
        let lines: Vec<_> = (0..100).map(|number| format!("line {number}\n")).collect();
        for line in &lines {
            assert_eq!(writer.write(line.as_bytes()).unwrap(), line.len());
        }
        LogWriter::flush(&writer, Duration::from_secs(60));
        let expected = lines.concat();
        let mut written = vec![0; expected.len()];
        reader.read_exact(&mut written).unwrap();
        assert_eq!(String::from_utf8(written).unwrap(), expected);
        assert_eq!(writer.lost().get(), 0);
    }

    #[test]
    fn lines_that_nobody_reads_are_lost_and_counted_and_nobody_waits() {
        let (reader, output) = io::pipe().unwrap();
        let mut writer = LogWriter::start(output).unwrap();
        let line = [b'x'; 1000];
        // A pipe takes 64 KiB by default, and 1 MiB at most.
        for _ in 0..2 * WAITING {
            assert_eq!(writer.write(&line).unwrap(), line.len());
        }
        let lost = writer.lost().get();
        assert!((2000..=4096).contains(&lost), "{lost}");
        let begun = Instant::now();
        LogWriter::flush(&writer, Duration::from_millis(20));
        assert!(begun.elapsed() >= Duration::from_millis(20));
        drop(reader);
    }
}
