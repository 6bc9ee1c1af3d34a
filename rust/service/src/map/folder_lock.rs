//! The lock of a map's folder: a folder belongs to one service.

use std::fs::{self, File, TryLockError};
use std::path::Path;

use super::file_error::{RoadFileError, system};

/// The file in the folder that is locked.
const LOCK: &str = ".lock";

/// Makes the folder if it does not exist, and locks it until the returned file is dropped: of two services, each would
/// replace the files of the other one.
///
/// # Errors
/// [`RoadFileError::Locked`] if another service keeps the folder, else [`RoadFileError::System`].
pub(crate) fn lock(folder: &Path) -> Result<File, RoadFileError> {
    fs::create_dir_all(folder).map_err(system(folder))?;
    let path = folder.join(LOCK);
    let mut options = File::options();
    let options = options.create(true).truncate(false).read(true).write(true);
    let file = options.open(&path).map_err(system(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(RoadFileError::Locked(folder.to_owned())),
        Err(TryLockError::Error(source)) => Err(system(&path)(source)),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_has_one_service_at_a_time() {
        let folder = std::env::temp_dir().join(format!("egp-lock-{}", std::process::id()));
        let first = lock(&folder).unwrap();
        let error = lock(&folder).unwrap_err().to_string();
        let words = format!("another map service keeps the folder {}", folder.display());
        assert!(error.contains(&words), "{error}");
        drop(first);
        lock(&folder).unwrap();
        fs::remove_dir_all(&folder).unwrap();
    }
}
