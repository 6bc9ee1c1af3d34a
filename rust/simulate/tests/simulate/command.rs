//! The program `egp-simulate`.

use std::process::Command;
use std::time::Duration;

use egp_testing::outputs::interrupted;

use crate::shipped;

fn program() -> Command {
    let [library, other] = shipped();
    let mut command = Command::new(env!("CARGO_BIN_EXE_egp-simulate"));
    command.args([library.as_os_str(), "--other".as_ref(), other.as_os_str()]);
    command
}

#[test]
fn an_interrupted_search_prints_what_it_found() {
    let mut searching = program();
    let output = interrupted(
        searching.args(["--seeds", "0..1000000"]),
        Duration::from_millis(100),
    );
    let told = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(130), "{told}");
    assert!(told.starts_with("interrupted after "), "{told}");
}

#[test]
fn a_fault_after_the_end_of_the_run_is_an_error() {
    let options = ["--seed", "0", "--seconds", "3", "--fault", "kill:r0@3+1"];
    let output = program().args(options).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let told = String::from_utf8_lossy(&output.stderr);
    let expected = "kill:r0@3+1 begins after the end of the run, which takes 3 s";
    assert!(told.contains(expected), "{told}");
}

#[test]
fn a_fault_of_nobody_is_named_as_it_was_written() {
    let fault = ["--seed", "0", "--fault", "kill:r9@1+2"];
    let output = program().args(fault).output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("kill:r9@1+2 is a fault of"), "{told}");
}
