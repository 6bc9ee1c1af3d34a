//! The roads' files: one `egp.v1.StoredRoad` for each road of each fleet.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use egp_map::Tile;
use egp_wire::keys::Name;
use egp_wire::road_keys::RoadKey;
use egp_wire::{ROAD_TILES, VERSION, proto, read_regular};
use prost::Message as _;
use ring::digest::{SHA256, SHA256_OUTPUT_LEN, digest};

use super::file_error::{RoadFileError, system};
use super::store::{Road, Store, StoreError};

const SUFFIX: &str = "road";
/// Bytes of the field `sha256` of a file: tag, length and content.
const CHECKSUM: usize = 2 + SHA256_OUTPUT_LEN;
/// Largest file that is read, bytes: the longest road with 64 vehicles takes less.
const LARGEST: u64 = 2 << 30;

/// Times of the files, ms since 1970, and of the store, s.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clocks {
    pub unix_ms: u64,
    pub now: f64,
}

/// Reads the files of a folder. Contributions that are too old are left out. A file whose contributions are all too old is
/// renamed and not removed, because the system's clock may be wrong. A file that is damaged is renamed, too, and the other
/// ones are read.
///
/// # Errors
/// [`RoadFileError::System`] if a file cannot be read or renamed, [`RoadFileError::Newer`] if one has a later version, and
/// [`RoadFileError::Limits`] if one has contributions for which the store has no room. The file at fault stays
/// as it is; others may have been renamed before.
pub(crate) fn load(folder: &Path, store: &mut Store, clocks: Clocks) -> Result<(), RoadFileError> {
    let mut unsaved = BTreeSet::new();
    for entry in fs::read_dir(folder).map_err(system(folder))? {
        let path = entry.map_err(system(folder))?.path();
        if path.extension().is_none_or(|suffix| suffix != SUFFIX) {
            continue;
        }
        let bytes = read_regular(&path, LARGEST).map_err(system(&path))?;
        let stored = proto::StoredRoad::decode(bytes.as_slice());
        let version = stored.as_ref().map_or(VERSION, |road| road.version);
        if version > VERSION {
            return Err(RoadFileError::Newer { path, version });
        }
        let file = path.display();
        let stored = stored.map_err(|error| error.to_string());
        match stored.and_then(|stored| parse(stored, &bytes)) {
            Ok((road, evidence)) => {
                let added = add(&road, evidence, store, clocks);
                if added.beyond > 0 {
                    let count = added.beyond;
                    return Err(RoadFileError::Limits { path, count });
                }
                if !added.useful {
                    let kept = set_aside(&path, "old").map_err(system(&path))?;
                    let kept = kept.display();
                    tracing::warn!(
                        %file, %kept,
                        "all evidence of this file is too old; it was renamed, and can be removed if the system's clock is right"
                    );
                }
                if added.future {
                    tracing::warn!(
                        %file,
                        "this file has evidence from the future, which counts as measured now; check the system's clock"
                    );
                    unsaved.insert(road);
                }
            }
            Err(reason) => {
                let kept = set_aside(&path, "damaged").map_err(system(&path))?;
                let kept = kept.display();
                tracing::error!(%file, reason, %kept, "this file of a road is damaged and was renamed; the map starts without it");
            }
        }
    }
    store.take_changed();
    store.unsaved = unsaved;
    Ok(())
}

/// Renames a file to `NAME.REASON`, or with a number behind it if there is such a file already. Returns its path.
fn set_aside(path: &Path, reason: &str) -> io::Result<PathBuf> {
    let named = |number: u32| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".{reason}"));
        if number > 0 {
            name.push(format!("-{number}"));
        }
        PathBuf::from(name)
    };
    let (mut number, mut kept) = (0, named(0));
    while kept.exists() {
        number += 1;
        kept = named(number);
    }
    fs::rename(path, &kept)?;
    Ok(kept)
}

/// A contribution in a file.
struct Evidence {
    vehicle: Name,
    index: u32,
    tile: Tile,
    measured_ms: u64,
}

/// The road and the contributions of a file with these bytes, or what was expected and what came.
fn parse(stored: proto::StoredRoad, bytes: &[u8]) -> Result<(Road, Vec<Evidence>), String> {
    if stored.version != VERSION {
        return Err(format!(
            "expected version {VERSION}, got {}",
            stored.version
        ));
    }
    let content = &bytes[..bytes.len().saturating_sub(CHECKSUM)];
    if stored.sha256 != digest(&SHA256, content).as_ref() {
        return Err(
            "its bytes do not have the SHA-256 that it states, or it states none".to_owned(),
        );
    }
    let name = |text: &str| text.parse::<Name>().map_err(|error| error.to_string());
    let read = |evidence: proto::StoredEvidence| {
        if evidence.tile >= ROAD_TILES {
            return Err(format!(
                "expected a tile below {ROAD_TILES}, got {}",
                evidence.tile
            ));
        }
        Ok(Evidence {
            vehicle: name(&evidence.vehicle)?,
            index: evidence.tile,
            tile: Tile::from_bytes(&evidence.rows).map_err(|error| error.to_string())?,
            measured_ms: evidence.measured_ms,
        })
    };
    let evidence = stored
        .evidence
        .into_iter()
        .map(read)
        .collect::<Result<_, _>>()?;
    Ok(((name(&stored.fleet)?, name(&stored.road)?), evidence))
}

/// What was found in a file.
#[derive(Default)]
struct Added {
    /// Whether a contribution is not too old.
    useful: bool,
    /// Whether a contribution was measured in the future, by the system's clock.
    future: bool,
    /// Number of contributions for which the store has no room.
    beyond: usize,
}

/// Adds the contributions of a file.
fn add(road: &Road, evidence: Vec<Evidence>, store: &mut Store, clocks: Clocks) -> Added {
    let mut found = Added::default();
    let mut vehicles: BTreeMap<u32, usize> = BTreeMap::new();
    for Evidence {
        vehicle,
        index,
        tile,
        measured_ms,
    } in evidence
    {
        let (fleet, road) = road.clone();
        let key = RoadKey {
            fleet,
            vehicle,
            road,
        };
        found.future |= measured_ms > clocks.unix_ms;
        let age = clocks.unix_ms.saturating_sub(measured_ms) as f64 / 1e3;
        let added = store.add(&key, index, tile, clocks.now - age, clocks.now);
        match added {
            Ok(()) => *vehicles.entry(index).or_default() += 1,
            Err(StoreError::Old { .. }) => continue,
            Err(_) => found.beyond += 1,
        }
        found.useful = true;
    }
    // The oldest vehicles of a tile make room for further ones.
    let most = store.limits().vehicles;
    found.beyond += (vehicles.values())
        .map(|count| count.saturating_sub(most))
        .sum::<usize>();
    found
}

/// The file of a road.
pub(super) fn path(folder: &Path, (fleet, name): &Road) -> PathBuf {
    // No name has the character @, so the files of different roads have different names.
    folder.join(format!("{fleet}@{name}.{SUFFIX}"))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_map::{MergeSettings, TILE_BYTES};

    use super::super::encoding::{encode, with_checksum};
    use super::super::store::MapLimits;
    use super::super::writer::write;
    use super::*;

    const CLOCKS: Clocks = Clocks {
        unix_ms: 1_800_000_000_000,
        now: 0.0,
    };

    fn name(text: &str) -> Name {
        text.parse().unwrap()
    }

    fn store() -> Store {
        store_of(10, 10)
    }

    fn store_of(contributions: usize, vehicles: usize) -> Store {
        let limits = MapLimits {
            contributions,
            vehicles,
            tiles: 10,
            roads: 10,
        };
        Store::new(MergeSettings::default(), limits)
    }

    /// A new folder with the file of the road `depot@ring`, and that file.
    fn folder(test: &str) -> (PathBuf, PathBuf) {
        let folder = std::env::temp_dir().join(format!("egp-map-{test}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let (mut store, road) = (store(), (name("depot"), name("ring")));
        let key = RoadKey {
            fleet: road.0.clone(),
            vehicle: name("a"),
            road: road.1.clone(),
        };
        let tile = Tile::from_bytes(&[7, 0].repeat(TILE_BYTES / 2)).unwrap();
        store.add(&key, 3, tile, 0.0, 0.0).unwrap();
        save(&folder, &store, CLOCKS);
        let file = folder.join("depot@ring.road");
        (folder, file)
    }

    /// Writes the file of the road `depot@ring`.
    fn save(folder: &Path, store: &Store, clocks: Clocks) {
        let road = (name("depot"), name("ring"));
        let bytes = encode(&road, store.road(&road).unwrap(), clocks);
        write(folder, &road, Some(with_checksum(bytes))).unwrap();
    }

    /// What a service finds in the folder.
    fn loaded(folder: &Path, clocks: Clocks) -> Store {
        let mut store = store();
        load(folder, &mut store, clocks).unwrap();
        store
    }

    #[test]
    fn a_file_of_a_later_version_is_an_error_and_stays() {
        let (folder, file) = folder("later");
        let mut bytes = fs::read(&file).unwrap();
        bytes.extend([8, 2]); // the field `version`, of which the last value counts
        fs::write(&file, &bytes).unwrap();
        let error = load(&folder, &mut store(), CLOCKS).unwrap_err();
        assert!(matches!(error, RoadFileError::Newer { version: 2, .. }));
        assert_eq!(fs::read(&file).unwrap(), bytes);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn damaged_files_are_renamed_and_the_others_are_read() {
        let (folder, file) = folder("damaged");
        let good = fs::read(&file).unwrap();
        let mut flipped = good.clone();
        flipped[good.len() / 2] ^= 1;
        for (damaged, kept) in [
            (&good[..good.len() / 2], "depot@ring.road.damaged"),
            (&[], "depot@ring.road.damaged-1"),
            (&flipped, "depot@ring.road.damaged-2"),
            // The file ends between two records.
            (&good[..good.len() - CHECKSUM], "depot@ring.road.damaged-3"),
        ] {
            fs::write(&file, damaged).unwrap();
            fs::write(folder.join("other.road"), &good).unwrap();
            assert_eq!(loaded(&folder, CLOCKS).contributions(), 1, "{kept}");
            assert_eq!(fs::read(folder.join(kept)).unwrap(), damaged);
            assert!(!file.exists());
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_file_beyond_the_limits_is_an_error_and_stays() {
        let (folder, file) = folder("limits");
        let bytes = fs::read(&file).unwrap();
        for (contributions, vehicles) in [(0, 10), (10, 0)] {
            let mut store = store_of(contributions, vehicles);
            let error = load(&folder, &mut store, CLOCKS).unwrap_err();
            assert!(matches!(error, RoadFileError::Limits { count: 1, .. }));
            assert_eq!(fs::read(&file).unwrap(), bytes);
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_file_whose_evidence_is_too_old_is_renamed() {
        let (folder, file) = folder("old");
        let bytes = fs::read(&file).unwrap();
        let later = Clocks {
            unix_ms: CLOCKS.unix_ms + 1_000_000_000,
            now: 0.0,
        };
        assert_eq!(loaded(&folder, later).contributions(), 0);
        assert_eq!(fs::read(folder.join("depot@ring.road.old")).unwrap(), bytes);
        assert!(!file.exists());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn evidence_from_the_future_is_of_now_and_is_written_so() {
        let (folder, _) = folder("future");
        assert!(loaded(&folder, CLOCKS).unsaved.is_empty());
        let earlier = Clocks {
            unix_ms: CLOCKS.unix_ms - 1_000_000,
            now: 5.0,
        };
        let store = loaded(&folder, earlier);
        let road = (name("depot"), name("ring"));
        assert_eq!(store.road(&road).unwrap()[&3][&name("a")].at, earlier.now);
        assert!(store.unsaved.contains(&road));
        save(&folder, &store, earlier);
        assert!(loaded(&folder, earlier).unsaved.is_empty());
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_road_that_is_no_regular_file_is_an_error() {
        let (folder, _) = folder("pipe");
        let made = std::process::Command::new("mkfifo")
            .arg(folder.join("depot@park.road"))
            .status();
        assert!(made.unwrap().success());
        let error = load(&folder, &mut store(), CLOCKS).unwrap_err();
        assert!(
            error.to_string().contains("expected a regular file"),
            "{error}"
        );
        fs::remove_dir_all(&folder).unwrap();
    }
}
