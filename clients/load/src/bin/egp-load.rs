//! Measures how many vehicles a service can keep on the road.

use std::process::ExitCode;

#[allow(unsafe_code)]
fn main() -> ExitCode {
    // SAFETY: no other thread runs yet.
    unsafe { egp_wire::set_network_threads(egp_wire::ask_for_tls(std::env::args_os())) };
    egp_load::main(std::env::args_os()).into()
}
