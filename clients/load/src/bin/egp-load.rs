//! Measures how many vehicles a service can keep on the road.

use std::process::ExitCode;

fn main() -> ExitCode {
    egp_load::main(std::env::args_os()).into()
}
