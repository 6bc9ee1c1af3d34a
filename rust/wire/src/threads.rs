//! The threads of zenoh, which an environment variable sets for the whole process.

use std::env;
use std::ffi::OsStr;

const VARIABLE: &str = "ZENOH_RUNTIME";
const EIGHT_RECEIVE: &str = "(rx: (worker_threads: 8))";
const ONE_FOR_BOTH: &str = "(rx: (handover: tx), tx: (worker_threads: 1))";

/// Sets the threads with which zenoh sends and receives, unless `ZENOH_RUNTIME` states them. `encrypted` says that links of
/// this process use TLS. zenoh reads the variable when it opens the first session.
///
/// Without TLS eight threads receive. Closing the link to a silent process blocks one of them for 30 to 50 ms. zenoh starts two,
/// so that a vehicle misses the answers of a healthy replica when the lease of a frozen one ends, and a service those of all
/// vehicles when several fall silent together.
///
/// With TLS one thread sends and receives, because zenoh lets two threads write and read one connection of TLS at the same
/// time, which ends links and can damage the memory (issue 2557 of zenoh). The price is that closing a silent link delays all
/// others. A router needs several threads, because one that passes a large message on would wait for itself.
///
/// # Safety
/// No other thread may run, as for [`env::set_var`].
#[allow(unsafe_code)]
pub unsafe fn set_network_threads(encrypted: bool) {
    if env::var_os(VARIABLE).is_none() {
        let threads = if encrypted {
            ONE_FOR_BOTH
        } else {
            EIGHT_RECEIVE
        };
        // SAFETY: the caller guarantees that no other thread reads the environment meanwhile.
        unsafe { env::set_var(VARIABLE, threads) };
    }
}

/// Whether the arguments of a program name an endpoint of TLS, or a configuration of zenoh with `--zenoh`.
pub fn ask_for_tls(arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> bool {
    arguments.into_iter().any(|argument| {
        let argument = argument.as_ref().to_string_lossy();
        argument.contains("tls/") || argument.starts_with("--zenoh")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tls_is_found_in_arguments() {
        for arguments in [
            ["--connect", "tls/host:7447"],
            ["--connect=tls/host:7447", "-v"],
            ["--zenoh", "car.json5"],
            ["--zenoh=car.json5", "-v"],
        ] {
            assert!(ask_for_tls(arguments), "{arguments:?}");
        }
        assert!(!ask_for_tls(["--connect", "tcp/host:7447"]));
    }
}
