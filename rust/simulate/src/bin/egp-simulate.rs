//! Replays one seed with a readable trace, runs many seeds, or shows which oracle finds each planted fault.

use std::process::ExitCode;

fn main() -> ExitCode {
    egp_simulate::main(std::env::args_os()).into()
}
