//! Reading a library's file, and replacing files.

use std::fs::{self, File};
use std::io::{self, Read as _, Write as _};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use egp_core::library::MAX_FILE_BYTES;

/// The bytes of a library's file, but at most one more than a library may have, which suffices to detect a file that is
/// too large.
///
/// # Errors
/// As [`read_regular`].
pub fn read_library(path: &Path) -> io::Result<Vec<u8>> {
    read_regular(path, MAX_FILE_BYTES as u64 + 1)
}

/// The bytes of a file, but at most `most`.
///
/// # Errors
/// [`io::Error`] if the file cannot be read, or is not a regular file: opening a pipe would wait for a writer.
pub fn read_regular(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    if !fs::metadata(path)?.is_file() {
        let reason = "expected a regular file, got a folder, a pipe or a device";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(most).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Replaces a file atomically: whoever opens the path gets the old bytes or the new ones, also after a crash. The new bytes
/// are written into `NAME.PID.NUMBER.part` beside the file first, with a number for each call.
///
/// # Errors
/// [`io::Error`] if the file cannot be written. The path then has the old bytes, unless only the last step failed, which
/// writes the folder's entry to the disk.
pub fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    static CALLS: AtomicU64 = AtomicU64::new(0);
    let number = CALLS.fetch_add(1, Ordering::Relaxed);
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.{number}.part", std::process::id()));
    let beside = path.with_file_name(name);
    let written = File::create(&beside).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&beside, path)
    });
    if written.is_err() {
        // The first error is the one to report, and a file that was not made need not be removed.
        let _ = fs::remove_file(&beside);
        return written;
    }
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}
