//! Programs whose standard output takes nothing.

use std::fs::File;
use std::process::{Command, Output, Stdio};

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
