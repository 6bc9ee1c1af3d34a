//! Reading a library's file.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::Path;

use egp_core::library::MAX_FILE_BYTES;

/// The bytes of a library's file, but at most one more than a library may have, which suffices to detect a file that is
/// too large.
///
/// # Errors
/// [`io::Error`] if the file cannot be read, or is not a regular file: opening a pipe would wait for a writer.
pub fn read_library(path: &Path) -> io::Result<Vec<u8>> {
    if !fs::metadata(path)?.is_file() {
        let reason = "expected a regular file, got a folder, a pipe or a device";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    let mut bytes = Vec::new();
    File::open(path)?
        .take(MAX_FILE_BYTES as u64 + 1)
        .read_to_end(&mut bytes)?;
    Ok(bytes)
}
