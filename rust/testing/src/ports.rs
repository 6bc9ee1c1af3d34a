//! Ports of this machine for services that a test starts.

use std::net::TcpListener;

use rand::RngExt as _;
use rand::rand_core::UnwrapErr;
use rand::rngs::SysRng;

/// The ports to choose from: the operating system gives others to outgoing connections and to whoever asks for any free port,
/// so that no other test of this machine receives the port before the service listens on it.
const PORTS: std::ops::Range<u16> = 15_000..32_000;

/// A port of the loopback address on which nobody listens.
pub fn free_port() -> u16 {
    let mut random = UnwrapErr(SysRng);
    std::iter::repeat_with(|| random.random_range(PORTS))
        .take(1000)
        .find(|&port| TcpListener::bind(("127.0.0.1", port)).is_ok())
        .unwrap()
}

/// An endpoint of zenoh at a port on which nobody listens.
pub fn free_endpoint() -> String {
    format!("tcp/127.0.0.1:{}", free_port())
}
