//! What programs write to their standard output and standard error.

use std::fmt::Display;
use std::io::{self, Write};

/// Writes a text and the end of its line to the standard output. Returns false if the reader has closed the
/// pipe, as `head` does after its lines. This is no error, and the program should write nothing more.
///
/// # Errors
/// [`io::Error`] if the text cannot be written, because a disk is full for instance.
pub fn print_line(text: impl Display) -> io::Result<bool> {
    write_line(&mut io::stdout().lock(), &text)
}

/// Writes a text and the end of its line to the standard error. If it cannot be written, there is no other place for it, and
/// the program goes on.
pub fn print_notice(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}

fn write_line(out: &mut impl Write, text: &dyn Display) -> io::Result<bool> {
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        Err(error) => {
            let reason = format!("cannot write to the standard output: {error}");
            Err(io::Error::new(error.kind(), reason))
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_that_has_gone_is_no_error_and_a_full_disk_is_one() {
        let mut line = Vec::new();
        assert!(write_line(&mut line, &"text").unwrap());
        assert_eq!(line, b"text\n");
        let (reader, mut gone) = io::pipe().unwrap();
        drop(reader);
        assert!(!write_line(&mut gone, &"text").unwrap());
        let mut room = [0; 3];
        let error = write_line(&mut room.as_mut_slice(), &"text").unwrap_err();
        assert!(error.to_string().contains("standard output"), "{error}");
    }
}
