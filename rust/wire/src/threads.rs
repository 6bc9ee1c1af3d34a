//! The threads of zenoh, which an environment variable sets for the whole process.

use std::env;

const VARIABLE: &str = "ZENOH_RUNTIME";
const EIGHT: &str = "(rx: (worker_threads: 8))";

/// Lets zenoh receive with eight threads unless `ZENOH_RUNTIME` states their number.
///
/// Closing the link to a silent process blocks one receive thread for 30 to 50 ms. zenoh starts two, so that a vehicle
/// misses the answers of a healthy replica when the lease of a frozen one ends, and a service those of all vehicles when
/// several fall silent together. Programs call this first; zenoh reads the variable when it opens the first session.
///
/// # Safety
/// No other thread may run, as for [`env::set_var`].
#[allow(unsafe_code)]
pub unsafe fn set_receive_threads() {
    if env::var_os(VARIABLE).is_none() {
        // SAFETY: the caller guarantees that no other thread reads the environment meanwhile.
        unsafe { env::set_var(VARIABLE, EIGHT) };
    }
}
