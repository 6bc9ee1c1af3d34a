//! A thread that ends with the value that started it.

use std::io;
use std::thread::{self, JoinHandle};

/// A thread that ends once `stop` is dropped. Dropping this value drops `stop` and waits for the thread.
pub(crate) struct Background<S> {
    stop: Option<S>,
    thread: Option<JoinHandle<()>>,
    name: &'static str,
}

impl<S> Background<S> {
    /// Starts the thread.
    ///
    /// # Errors
    /// If the system cannot start it.
    pub(crate) fn start(
        name: &'static str,
        stop: S,
        work: impl FnOnce() + Send + 'static,
    ) -> io::Result<Self> {
        let thread = thread::Builder::new().name(name.to_owned()).spawn(work)?;
        Ok(Self {
            stop: Some(stop),
            thread: Some(thread),
            name,
        })
    }
}

impl<S> Drop for Background<S> {
    fn drop(&mut self) {
        drop(self.stop.take());
        if self
            .thread
            .take()
            .is_some_and(|thread| thread.join().is_err())
        {
            tracing::error!(thread = self.name, "a thread ended by a panic");
        }
    }
}
