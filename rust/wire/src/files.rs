//! Reading files that an operator names. A path may lead to a pipe, whose opening would wait for a writer, or to a device that
//! has no end.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::Path;

/// Largest number of bytes of a text file.
const MOST_TEXT: u64 = 16 << 20;

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

/// The text of a file of at most 16 MiB, such as a configuration, keys or a certificate.
///
/// # Errors
/// [`io::Error`] as of [`read_regular`], or if the file has more bytes or is no text in UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read_regular(path, MOST_TEXT + 1)?;
    let wrong = |reason: &str| io::Error::new(io::ErrorKind::InvalidData, reason);
    if bytes.len() as u64 > MOST_TEXT {
        return Err(wrong("expected a text of at most 16 MiB, got more"));
    }
    String::from_utf8(bytes).map_err(|_| wrong("expected a text in UTF-8, got other bytes"))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn only_texts_of_regular_files_are_read() {
        let folder = std::env::temp_dir().join(format!("egp-files-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = |name: &str| folder.join(name);
        fs::write(path("text"), "äöü").unwrap();
        assert_eq!(read_text(&path("text")).unwrap(), "äöü");
        fs::write(path("bytes"), [0xff]).unwrap();
        let large = File::create(path("large")).unwrap();
        large.set_len(MOST_TEXT + 1).unwrap();
        let made = Command::new("mkfifo").arg(path("pipe")).status();
        assert!(made.unwrap().success());
        for (file, reason) in [
            (path("bytes"), "in UTF-8"),
            (path("large"), "at most 16 MiB"),
            (path("pipe"), "expected a regular file"),
            (folder.clone(), "expected a regular file"),
            ("/dev/zero".into(), "expected a regular file"),
        ] {
            let error = read_text(&file).unwrap_err().to_string();
            assert!(error.contains(reason), "{}: {error}", file.display());
        }
        large.set_len(MOST_TEXT).unwrap();
        assert_eq!(read_text(&path("large")).unwrap().len() as u64, MOST_TEXT);
        fs::remove_dir_all(&folder).unwrap();
    }
}
