//! Replacing files.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// Replaces a file atomically: whoever opens the path gets the old bytes or the new ones, also after a crash. The new bytes
/// are written into a new file `NAME.PID.NUMBER.part` beside the file first. A process that is killed leaves it behind.
///
/// # Errors
/// [`io::Error`] if the file cannot be written. The path then has the old bytes, unless only the last step failed, which
/// writes the folder's entry to the disk.
pub fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    Replacement::write(path, bytes)?.replace()
}

/// New bytes of a file that are written beside it. They are removed unless [`Replacement::replace`] or [`Replacement::rename`]
/// puts them in its place. A caller that writes all new files before it replaces the first one leaves every old file in place
/// if one cannot be written.
pub struct Replacement {
    path: PathBuf,
    /// The file that has the new bytes; none once it has the name `path`, because its earlier name is then free for other
    /// writers.
    beside: Option<PathBuf>,
}

impl Replacement {
    /// Writes the bytes beside the file, to the disk. If the path is a link, the file to which it leads is replaced.
    ///
    /// # Errors
    /// [`io::Error`] if they cannot be written, or as [`replaceable`].
    pub fn write(path: &Path, bytes: &[u8]) -> io::Result<Self> {
        let path = replaceable(path)?;
        let (mut file, beside) = create_beside(&path)?;
        let written = Self {
            path,
            beside: Some(beside),
        };
        file.write_all(bytes)?;
        file.sync_all()?;
        Ok(written)
    }

    /// The file that is replaced.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces the file, and writes the folder's entry to the disk.
    ///
    /// # Errors
    /// As [`replace_file`].
    pub fn replace(self) -> io::Result<()> {
        let path = self.path.clone();
        self.rename()?;
        sync_folder(&path)
    }

    /// Replaces the file, but does not write the folder's entry to the disk, which is left to [`sync_folder`].
    ///
    /// # Errors
    /// [`io::Error`] if the system refuses it; the path then has the old bytes.
    pub fn rename(mut self) -> io::Result<()> {
        if let Some(beside) = &self.beside {
            fs::rename(beside, &self.path)?;
        }
        self.beside = None;
        Ok(())
    }
}

/// The file that is replaced, or made, if bytes are written to a path: the path itself, or the file to which it leads as a
/// link.
///
/// # Errors
/// [`io::Error`] if there is a folder, a pipe or a device, which no file may replace, or if links lead in a circle.
pub fn replaceable(path: &Path) -> io::Result<PathBuf> {
    /// Links that are followed at most, as many as Linux follows.
    const LINKS: usize = 40;
    if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        let reason = "expected a regular file or a new name, got a folder, a pipe or a device";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    let mut file = path.to_owned();
    for _ in 0..=LINKS {
        match fs::read_link(&file) {
            Ok(target) => file = file.with_file_name(target),
            Err(_) => return Ok(file),
        }
    }
    let reason = "its links lead in a circle; choose another file";
    Err(io::Error::new(io::ErrorKind::InvalidInput, reason))
}

/// Writes the entries of the folder in which a file is to the disk, so that they are the same after a crash.
///
/// # Errors
/// [`io::Error`] if the system cannot write them.
pub fn sync_folder(file: &Path) -> io::Result<()> {
    let folder = file.parent();
    let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

/// Largest number of files beside a file that are looked at for a free name. They are left over by processes that were killed
/// while they wrote.
const MOST_BESIDE: u32 = 10_000;

/// Makes `NAME.PID.NUMBER.part` with the first number that no other file has: a process with the same id may write the same
/// file from another container.
fn create_beside(path: &Path) -> io::Result<(File, PathBuf)> {
    for number in 0..MOST_BESIDE {
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}.{number}.part", std::process::id()));
        let beside = path.with_file_name(name);
        match File::create_new(&beside) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            made => return made.map(|file| (file, beside)),
        }
    }
    let reason =
        "all names of the file to write first are in use; delete the old `.part` files beside it";
    Err(io::Error::new(io::ErrorKind::AlreadyExists, reason))
}

impl Drop for Replacement {
    fn drop(&mut self) {
        if let Some(beside) = &self.beside {
            // An error is not reported: the file that was to be replaced is as before.
            let _ = fs::remove_file(beside);
        }
    }
}
