//! Ports of this machine for services that a test starts.

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use rand::RngExt as _;
use rand::rand_core::UnwrapErr;
use rand::rngs::SysRng;

/// The ports to choose from. Linux by default gives larger ones to outgoing connections and to programs that ask for any free
/// port, so that only another call of this function may choose the same one before the service listens.
const PORTS: Range<u16> = 20_000..32_000;

/// A port of the loopback address on which nobody listens, another one at each call of this process.
pub fn free_port() -> u16 {
    static GIVEN: Mutex<BTreeSet<u16>> = Mutex::new(BTreeSet::new());
    let mut given = GIVEN.lock().unwrap_or_else(PoisonError::into_inner);
    let mut random = UnwrapErr(SysRng);
    std::iter::repeat_with(|| random.random_range(PORTS))
        .take(1000)
        .find(|&port| TcpListener::bind(("127.0.0.1", port)).is_ok() && given.insert(port))
        .unwrap()
}

/// An endpoint of zenoh at a port on which nobody listens.
pub fn free_endpoint() -> String {
    format!("tcp/127.0.0.1:{}", free_port())
}
