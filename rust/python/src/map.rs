//! The map service, its messages and its keys.

use std::borrow::Cow;

use egp_service::map::MapConfig;
use egp_wire::keys::Name;
use egp_wire::road_keys::{self, RoadKey};
use egp_wire::{RoadTiles, TileEvidence};
use pyo3::prelude::*;

use crate::error::{InvalidArgumentError, raise};
use crate::service::after_signal;

/// Keep a map until SIGTERM, SIGHUP or Ctrl-C; `config_toml` is described in docs/settings.md. Raises `EgpError` if it does
/// not start, or if a road is not written at the end.
#[pyfunction]
pub fn serve_map(py: Python<'_>, config_toml: &str) -> PyResult<()> {
    let config = MapConfig::from_toml(config_toml).map_err(raise)?;
    let ended = py.detach(|| egp_service::map::serve_map(&config));
    after_signal(py)?;
    ended.map_err(raise)
}

/// Check what a map service needs to start, except its folder. Return a warning if one of its certificates expires within 30
/// days, otherwise `None`. Raises `EgpError` as `serve_map` does.
#[pyfunction]
pub fn check_map(py: Python<'_>, config_toml: &str) -> PyResult<Option<String>> {
    let config = MapConfig::from_toml(config_toml).map_err(raise)?;
    (py.detach(|| egp_service::map::check_map(&config))).map_err(raise)
}

/// The keys of a road of a fleet for one vehicle. Raises `InvalidArgumentError` for a text that is no name.
#[pyclass(name = "RoadKey", module = "egp_service._core", frozen)]
pub struct Keys(RoadKey);

#[pymethods]
impl Keys {
    #[new]
    fn new(fleet: &str, vehicle: &str, road: &str) -> PyResult<Self> {
        let name = |text: &str| text.parse::<Name>().map_err(InvalidArgumentError::raise);
        Ok(Self(RoadKey {
            fleet: name(fleet)?,
            vehicle: name(vehicle)?,
            road: name(road)?,
        }))
    }

    /// The key to which the vehicle sends what it measured in a tile.
    fn tile(&self, index: u32) -> String {
        self.0.tile(index)
    }

    /// The key on which the vehicle asks for tiles from `first` on.
    fn tiles(&self, first: u32) -> String {
        self.0.tiles(first)
    }

    /// The key on which the service publishes which tiles have new evidence.
    #[getter]
    fn changed(&self) -> String {
        road_keys::changed(&self.0.fleet, &self.0.road)
    }
}

/// What other vehicles measured in a tile.
#[pyclass(module = "egp_service._core", frozen, get_all)]
pub struct RoadTile {
    /// Index of the tile.
    index: u32,
    /// The tile, for `RoadBelief.report`.
    tile: Cow<'static, [u8]>,
    /// The vehicles, each with the time in s since its newest measurement when the answer was made.
    origins: Vec<(String, f64)>,
}

/// Bytes of a TileEvidence. Raises `InvalidArgumentError` unless the age in s is at most 49 days.
#[pyfunction]
pub fn encode_tile_evidence(tile: &[u8], age: f64) -> PyResult<Cow<'static, [u8]>> {
    let milliseconds = (1e3 * age).round();
    if !(0.0..=f64::from(u32::MAX)).contains(&milliseconds) {
        return Err(InvalidArgumentError::raise(format!(
            "expected an age of 0 to 4294967 s, got {age}"
        )));
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // in range
    let age_ms = milliseconds as u32;
    let rows = tile.to_vec();
    Ok(TileEvidence { age_ms, rows }.encode().into())
}

/// Read and validate a RoadTiles: the tiles, and whether there are more behind the last one.
#[pyfunction]
pub fn decode_road_tiles(data: &[u8]) -> PyResult<(Vec<RoadTile>, bool)> {
    let answer = RoadTiles::decode(data).map_err(raise)?;
    let tile = |tile: egp_wire::RoadTile| RoadTile {
        index: tile.index,
        tile: tile.rows.into(),
        origins: (tile.origins.iter())
            .map(|origin| (origin.vehicle.to_string(), f64::from(origin.age_ms) / 1e3))
            .collect(),
    };
    Ok((answer.tiles.into_iter().map(tile).collect(), answer.more))
}

/// Read and validate a TilesChanged: the indices of tiles with new evidence.
#[pyfunction]
pub fn decode_tiles_changed(data: &[u8]) -> PyResult<Vec<u32>> {
    egp_wire::decode_tiles_changed(data).map_err(raise)
}
