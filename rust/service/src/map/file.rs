//! The roads' files: one `egp.v1.StoredRoad` for each road of each fleet.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use egp_engine::replace_file;
use egp_map::Tile;
use egp_wire::keys::Name;
use egp_wire::road_keys::RoadKey;
use egp_wire::{ROAD_TILES, VERSION, proto};
use prost::Message as _;

use super::store::{Road, Store, StoreError, Tiles};

const SUFFIX: &str = "road";
/// Largest file that is read, bytes: the longest road with 64 vehicles takes less.
const LARGEST: u64 = 2 << 30;

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
    /// The content is not that of a road.
    #[error("{path} is no file of a road: {reason}; move it away to begin anew")]
    Content {
        /// The file.
        path: PathBuf,
        /// What was expected and what came.
        reason: String,
    },
}

/// Times of the files, ms since 1970, and of the store, s.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clocks {
    pub unix_ms: u64,
    pub now: f64,
}

/// Reads the files of a folder, which is made if it does not exist. Contributions that are too old, or for which the store
/// has no room, are left out. The log names a file whose contributions are all too old. It is not removed, because the
/// system's clock may be wrong.
pub(crate) fn load(folder: &Path, store: &mut Store, clocks: Clocks) -> Result<(), RoadFileError> {
    let system = |source| RoadFileError::System {
        path: folder.to_owned(),
        source,
    };
    fs::create_dir_all(folder).map_err(system)?;
    for entry in fs::read_dir(folder).map_err(system)? {
        let path = entry.map_err(system)?.path();
        if path.extension().is_some_and(|suffix| suffix == SUFFIX) {
            let bytes = read(&path).map_err(|source| RoadFileError::System {
                path: path.clone(),
                source,
            })?;
            let useful = add(&bytes, store, clocks).map_err(|reason| RoadFileError::Content {
                path: path.clone(),
                reason,
            })?;
            if !useful {
                let file = path.display();
                tracing::warn!(%file, "all evidence of this file is too old; it can be removed");
            }
        }
    }
    store.take_changed();
    Ok(())
}

fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(LARGEST).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Adds the contributions of a file: whether one of them is not too old.
fn add(bytes: &[u8], store: &mut Store, clocks: Clocks) -> Result<bool, String> {
    let stored = proto::StoredRoad::decode(bytes).map_err(|error| error.to_string())?;
    if stored.version != VERSION {
        return Err(format!(
            "expected version {VERSION}, got {}",
            stored.version
        ));
    }
    let name = |text: &str| text.parse::<Name>().map_err(|error| error.to_string());
    let (fleet, road) = (name(&stored.fleet)?, name(&stored.road)?);
    let mut useful = false;
    for evidence in stored.evidence {
        let key = RoadKey {
            fleet: fleet.clone(),
            vehicle: name(&evidence.vehicle)?,
            road: road.clone(),
        };
        if evidence.tile >= ROAD_TILES {
            return Err(format!(
                "expected a tile below {ROAD_TILES}, got {}",
                evidence.tile
            ));
        }
        let tile = Tile::from_bytes(&evidence.rows).map_err(|error| error.to_string())?;
        let age = clocks.unix_ms.saturating_sub(evidence.measured_ms) as f64 / 1e3;
        let added = store.add(&key, evidence.tile, tile, clocks.now - age, clocks.now);
        useful |= !matches!(added, Err(StoreError::Old { .. }));
        if let Err(error) = added {
            tracing::debug!(?key, %error, "stored evidence left out");
        }
    }
    Ok(useful)
}

/// Writes a road's file beside the old one and then replaces it; a road without evidence has no file.
pub(crate) fn save(
    folder: &Path,
    road: &Road,
    tiles: Option<&Tiles>,
    clocks: Clocks,
) -> Result<(), RoadFileError> {
    let (fleet, name) = road;
    // No name has the character @, so the files of different roads have different names.
    let path = folder.join(format!("{fleet}@{name}.{SUFFIX}"));
    let system = |source| RoadFileError::System {
        path: path.clone(),
        source,
    };
    let Some(tiles) = tiles else {
        return match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(system(error)),
            _ => Ok(()),
        };
    };
    let evidence = tiles.iter().flat_map(|(tile, vehicles)| {
        vehicles
            .iter()
            .map(|(vehicle, contribution)| proto::StoredEvidence {
                tile: *tile,
                vehicle: vehicle.to_string(),
                measured_ms: clocks
                    .unix_ms
                    .saturating_sub(age_ms(clocks.now - contribution.at)),
                rows: contribution.tile.bytes().to_vec(),
            })
    });
    let stored = proto::StoredRoad {
        version: VERSION,
        fleet: fleet.to_string(),
        road: name.to_string(),
        evidence: evidence.collect(),
    };
    replace_file(&path, &stored.encode_to_vec()).map_err(system)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a cast of floats saturates
fn age_ms(seconds: f64) -> u64 {
    (1e3 * seconds.max(0.0)) as u64
}
