//! Why a file of a road cannot be used.

use std::io;
use std::path::{Path, PathBuf};

use egp_wire::VERSION;

/// Why a file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RoadFileError {
    /// The system's error.
    #[error("{path}: {source}; check the folder, or name another one with --folder")]
    System {
        /// The file or folder.
        path: PathBuf,
        /// The error.
        source: io::Error,
    },
    /// Another service keeps the folder.
    #[error(
        "another map service keeps the folder {0}; stop it, or name another folder with --folder"
    )]
    Locked(PathBuf),
    /// A file of a later version of the program.
    #[error(
        "{path}: it has version {version}, and this program reads version {VERSION}; use the program that wrote it, or \
         name another folder with --folder"
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its version.
        version: u32,
    },
    /// A file with more contributions than the map may keep, which the next change of the road would remove from it.
    #[error(
        "{path}: {count} of its contributions are beyond the limits of this map; raise `contributions`, `vehicles`, \
         `tiles` or `roads`, or move the file out of the folder"
    )]
    Limits {
        /// The file.
        path: PathBuf,
        /// Number of contributions beyond the limits.
        count: usize,
    },
}

/// Makes an error of the system that names a file or folder.
pub(super) fn system(path: &Path) -> impl Fn(io::Error) -> RoadFileError {
    |source| RoadFileError::System {
        path: path.to_owned(),
        source,
    }
}
