//! Signals whose default action would end a program before it has written its results.

use std::ffi::c_int;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::{fs, io};

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

/// Those of the signals that this process does not ignore. A program that was started with an ignored signal, as by `nohup`
/// with SIGHUP, does not catch it.
pub fn not_ignored(signals: &[c_int]) -> Vec<c_int> {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default(); // Linux has it
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    let is_caught = |signal: &c_int| ignored.unwrap_or(0) >> (signal - 1) & 1 == 0;
    signals.iter().copied().filter(is_caught).collect()
}

/// Takes note of Ctrl-C (SIGINT) while it exists, so that a program can report what it has found until then. A second Ctrl-C
/// ends the process at once, with the status [`Interrupt::STATUS`]. Once it is dropped, Ctrl-C has no effect; a program drops
/// it shortly before its end.
pub struct Interrupt {
    came: Arc<AtomicBool>,
    actions: Vec<SigId>,
}

impl Interrupt {
    /// The exit status of a program that Ctrl-C ended.
    pub const STATUS: u8 = 130;

    /// Takes note of Ctrl-C from now on, unless the process ignores it.
    ///
    /// # Errors
    /// [`io::Error`] if the system does not let the process catch the signal.
    pub fn watch() -> io::Result<Self> {
        let came = Arc::new(AtomicBool::new(false));
        let mut actions = Vec::new();
        if not_ignored(&[SIGINT]).is_empty() {
            return Ok(Self { came, actions });
        }
        // The first action looks at the flag before the second one sets it.
        let second = flag::register_conditional_shutdown(SIGINT, Self::STATUS.into(), came.clone());
        actions.push(second?);
        actions.push(flag::register(SIGINT, came.clone())?);
        Ok(Self { came, actions })
    }

    /// Whether Ctrl-C came.
    pub fn came(&self) -> bool {
        self.came.load(Ordering::Relaxed)
    }
}

impl Drop for Interrupt {
    fn drop(&mut self) {
        for action in self.actions.drain(..) {
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
