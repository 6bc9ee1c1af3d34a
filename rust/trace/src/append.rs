//! Appending lines to a file.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::os::unix::fs::{FileExt as _, FileTypeExt as _};
use std::path::Path;

/// Opens a file to append to it. It is made if it does not exist.
///
/// # Errors
/// [`io::Error`] if it cannot be opened, or is a pipe: opening one would wait for a reader.
pub(crate) fn append(path: &Path) -> io::Result<File> {
    if fs::metadata(path).is_ok_and(|found| found.file_type().is_fifo()) {
        let reason = "expected a file, got a pipe";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    OpenOptions::new().append(true).create(true).open(path)
}

/// Appends a line, whose end is its last byte, to a file. If the file ends within a line, that line is ended first.
///
/// # Errors
/// [`io::Error`] as of [`append`], or if the line cannot be written; the file is then as before.
pub(crate) fn append_line(path: &Path, line: &[u8]) -> io::Result<()> {
    let mut file = append(path)?;
    let before = file.metadata()?.len();
    let bytes = if is_cut(path, before) {
        [b"\n", line].concat()
    } else {
        line.to_vec()
    };
    // A part of a line, as a full disk leaves it, would spoil the next line, too.
    file.write_all(&bytes)
        .inspect_err(|_| drop(file.set_len(before)))
}

/// Whether a file of this length ends within a line: a process that is killed, or a machine that loses its power, leaves a part
/// of one. A file that may be written and not read counts as whole.
fn is_cut(path: &Path, length: u64) -> bool {
    let mut last = [b'\n'];
    let read = length
        .checked_sub(1)
        .and_then(|before| Some(File::open(path).ok()?.read_exact_at(&mut last, before)));
    read.is_some_and(|read| read.is_ok()) && last != [b'\n']
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_was_cut_spoils_no_other_line() {
        let file = std::env::temp_dir().join(format!("egp-cut-line-{}", std::process::id()));
        for (before, after) in [
            ("", "new\n"),
            ("whole\n", "whole\nnew\n"),
            ("whole\ncu", "whole\ncu\nnew\n"),
        ] {
            fs::write(&file, before).unwrap();
            append_line(&file, b"new\n").unwrap();
            assert_eq!(fs::read_to_string(&file).unwrap(), after);
        }
        fs::remove_file(&file).unwrap();
    }
}
