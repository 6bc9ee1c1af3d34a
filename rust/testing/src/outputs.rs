//! What programs print if their standard output takes nothing, and after Ctrl-C.

use std::fs::{self, File};
use std::process::{Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Runs a program once with a pipe that its reader has closed, and once with a disk that is full (`/dev/full` of Linux).
/// Returns both outputs, and panics if one of them tells of a panic.
///
/// The first run must end without an error, and the second one with the exit code `code` and a message of the program `name`.
pub fn without_output(name: &str, code: i32, mut command: impl FnMut() -> Command) -> [Output; 2] {
    let (reader, closed) = std::io::pipe().unwrap();
    drop(reader);
    let full = File::options().write(true).open("/dev/full").unwrap();
    let reason = format!("{name}: cannot write to the standard output");
    [
        (Stdio::from(closed), 0, ""),
        (Stdio::from(full), code, &reason),
    ]
    .map(|(out, code, reason)| {
        let output = command()
            .stdout(out)
            .stderr(Stdio::piped())
            .output()
            .unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(message.starts_with(reason), "{message}");
        assert!(!message.contains("panicked"), "{message}");
        output
    })
}

/// Runs a program, sends it SIGINT `after` it has begun to catch this signal, and returns what it printed. Panics if it does not
/// catch the signal within a minute, which is read from `/proc` of Linux.
pub fn interrupted(command: &mut Command, after: Duration) -> Output {
    let child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let id = child.id().to_string();
    let catches = || {
        let status = fs::read_to_string(format!("/proc/{id}/status")).unwrap();
        let caught = (status.lines()).find_map(|line| line.strip_prefix("SigCgt:"));
        u64::from_str_radix(caught.unwrap().trim(), 16).unwrap() & 1 << (2 - 1) != 0 // SIGINT is 2
    };
    let begin = Instant::now();
    while !catches() {
        assert!(begin.elapsed().as_secs() < 60, "SIGINT is not caught");
        sleep(Duration::from_millis(10));
    }
    sleep(after);
    let sent = Command::new("kill").args(["-INT", &id]).status();
    assert!(sent.unwrap().success());
    child.wait_with_output().unwrap()
}
