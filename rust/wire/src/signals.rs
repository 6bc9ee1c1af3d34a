//! Signals that would end a program before it has said what it has to say.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGXFSZ};
use signal_hook::{SigId, flag, low_level};

/// Lets a write fail with an error at the limit of a file's size (`ulimit -f`). Without this, the signal SIGXFSZ ends the
/// process there. Programs that write files call this first.
///
/// # Errors
/// [`io::Error`] if the system does not let the process catch the signal.
pub fn survive_file_size_limit() -> io::Result<()> {
    flag::register(SIGXFSZ, Arc::default()).map(drop)
}

/// Takes note of Ctrl-C (SIGINT) while it exists, so that a program can report what it has found until then. A second Ctrl-C
/// ends the process at once, with the status [`Interrupt::STATUS`]. Once it is dropped, Ctrl-C has no effect; a program drops
/// it shortly before its end.
pub struct Interrupt {
    came: Arc<AtomicBool>,
    actions: [SigId; 2],
}

impl Interrupt {
    /// The exit status of a program that Ctrl-C ended.
    pub const STATUS: u8 = 130;

    /// Takes note of Ctrl-C from now on.
    ///
    /// # Errors
    /// [`io::Error`] if the system does not let the process catch the signal.
    pub fn watch() -> io::Result<Self> {
        let came = Arc::new(AtomicBool::new(false));
        // The first action looks at the flag before the second one sets it.
        let second = flag::register_conditional_shutdown(SIGINT, Self::STATUS.into(), came.clone());
        let second = second?;
        let first = flag::register(SIGINT, came.clone())?;
        Ok(Self {
            came,
            actions: [second, first],
        })
    }

    /// Whether Ctrl-C came.
    pub fn came(&self) -> bool {
        self.came.load(Ordering::Relaxed)
    }
}

impl Drop for Interrupt {
    fn drop(&mut self) {
        for action in self.actions {
            low_level::unregister(action);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_first_interrupt_is_noted() {
        let interrupt = Interrupt::watch().unwrap();
        assert!(!interrupt.came());
        low_level::raise(SIGINT).unwrap();
        assert!(interrupt.came());
    }
}
