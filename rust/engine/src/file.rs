//! Reading a library's file.

use std::io;
use std::path::Path;

use egp_core::library::MAX_FILE_BYTES;
use egp_wire::read_regular;

/// The bytes of a library's file, but at most one more than a library may have, which suffices to detect a file that is
/// too large.
///
/// # Errors
/// As [`read_regular`].
pub fn read_library(path: &Path) -> io::Result<Vec<u8>> {
    read_regular(path, MAX_FILE_BYTES as u64 + 1)
}
