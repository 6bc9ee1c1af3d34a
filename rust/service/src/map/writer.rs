//! The thread that writes the roads' files, one at a time, so that the keeper answers meanwhile.

use std::path::Path;
use std::sync::mpsc::{self, Receiver, SyncSender, TryRecvError};
use std::{fs, io, thread};

use egp_wire::replace_file;

use super::file::path;
use super::file_error::{RoadFileError, system};
use super::store::Road;

/// The new content of a road's file; none if the road has no evidence, and therefore no file.
pub(crate) type Content = Option<Vec<u8>>;

/// The keeper's side of the thread, which ends when this value is dropped.
pub(crate) struct Writer {
    roads: SyncSender<(Road, Content)>,
    outcomes: Receiver<bool>,
    road: Option<Road>,
}

impl Writer {
    /// Starts the thread, which calls `write` for each road, and `ended` after it.
    ///
    /// # Errors
    /// [`io::Error`] if the system cannot start a thread.
    pub(crate) fn start(
        write: impl Fn(&Road, Content) -> Result<(), RoadFileError> + Send + 'static,
        ended: impl Fn() + Send + 'static,
    ) -> io::Result<Self> {
        let (roads, waiting) = mpsc::sync_channel::<(Road, Content)>(1);
        let (told, outcomes) = mpsc::sync_channel(1);
        let thread = thread::Builder::new().name("egp-map-files".to_owned());
        thread.spawn(move || {
            for (road, content) in waiting {
                let written = write(&road, content);
                if let Err(error) = &written {
                    tracing::error!(%error, "a road was not written");
                }
                // After a panic of the keeper nothing receives the outcome.
                let _ = told.send(written.is_ok());
                ended();
            }
        })?;
        Ok(Self {
            roads,
            outcomes,
            road: None,
        })
    }

    /// The road that is being written.
    pub(crate) fn road(&self) -> Option<&Road> {
        self.road.as_ref()
    }

    /// Begins to write a road, after the writing of the one before has ended.
    pub(crate) fn begin(&mut self, road: Road, content: Content) {
        // If the thread has ended by a panic, the outcome is that nothing was written.
        let _ = self.roads.send((road.clone(), content));
        self.road = Some(road);
    }

    /// The road whose writing has ended, and whether it was written; none if it has not ended, or no road is written.
    pub(crate) fn ended(&mut self) -> Option<(Road, bool)> {
        let written = match self.outcomes.try_recv() {
            Err(TryRecvError::Empty) => return None,
            outcome => outcome.is_ok_and(|written| written),
        };
        self.road.take().map(|road| (road, written))
    }

    /// As [`Writer::ended`], but waits until the writing has ended.
    pub(crate) fn finish(&mut self) -> Option<(Road, bool)> {
        let road = self.road.take()?;
        let written = self.outcomes.recv();
        Some((road, written.is_ok_and(|written| written)))
    }
}

/// Writes a road's file beside the old one and then replaces it, or removes it.
pub(crate) fn write(folder: &Path, road: &Road, content: Content) -> Result<(), RoadFileError> {
    let path = path(folder, road);
    let written = match content {
        Some(bytes) => replace_file(&path, &bytes),
        None => match fs::remove_file(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            removed => removed,
        },
    };
    written.map_err(system(&path))
}

/// Whether this is the name of a road's new bytes, `NAME.road.PID.NUMBER.part`.
fn is_unfinished(name: &str) -> bool {
    let number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    name.strip_suffix(".part")
        .and_then(|rest| rest.rsplit_once(".road."))
        .and_then(|(_, numbers)| numbers.split_once('.'))
        .is_some_and(|(process, count)| number(process) && number(count))
}

/// Removes the new bytes of roads' files that a service could not put in their place because it was killed. The folder must be
/// locked: what another service writes has such a name, too.
///
/// # Errors
/// [`RoadFileError::System`] if the folder cannot be read, or a file cannot be removed.
pub(crate) fn remove_unfinished(folder: &Path) -> Result<(), RoadFileError> {
    for entry in fs::read_dir(folder).map_err(system(folder))? {
        let path = entry.map_err(system(folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if is_unfinished(&name) && path.is_file() {
            fs::remove_file(&path).map_err(system(&path))?;
        }
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use egp_wire::Replacement;

    use super::*;

    #[test]
    fn what_a_killed_service_has_begun_to_write_is_removed() {
        let folder = std::env::temp_dir().join(format!("egp-map-killed-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let road: Road = ("depot".parse().unwrap(), "ring".parse().unwrap());
        write(&folder, &road, Some(vec![7])).unwrap();
        let others = [
            "notes.part",
            "depot@ring.road.part",
            "depot@ring.road.1.x.part",
        ];
        for other in others {
            fs::write(folder.join(other), "").unwrap();
        }
        let begun = Replacement::write(&path(&folder, &road), &[8]).unwrap();
        std::mem::forget(begun);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2 + others.len());
        remove_unfinished(&folder).unwrap();
        assert_eq!(fs::read(path(&folder, &road)).unwrap(), [7]);
        assert!(others.iter().all(|other| folder.join(other).exists()));
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1 + others.len());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_thread_that_panicked_has_written_nothing() {
        let (ended, end) = mpsc::channel::<()>();
        let write = |_: &Road, _: Content| panic!("this panic is part of a test");
        let mut writer = Writer::start(write, move || ended.send(()).unwrap()).unwrap();
        assert_eq!((writer.ended(), writer.finish()), (None, None));
        let road: Road = ("depot".parse().unwrap(), "ring".parse().unwrap());
        for _ in 0..2 {
            writer.begin(road.clone(), None);
            assert_eq!(writer.finish(), Some((road.clone(), false)));
        }
        assert!(end.recv().is_err());
        writer.begin(road.clone(), None);
        assert_eq!(writer.ended(), Some((road, false)));
        assert_eq!(writer.road(), None);
    }
}
