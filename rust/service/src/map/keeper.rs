//! The thread that owns the store: it answers queries, publishes changes and writes files.

use std::mem;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use egp_map::Tile;
use egp_wire::{Code, TileEvidence, WireError, encode_tiles_changed, road_keys};

use super::file::{self, Clocks};
use super::intake::{Intake, Job, QueryKind};
use super::store::Store;
use crate::network::Putter;
use crate::query::Query as _;

// Messages and beliefs have the same tiles.
const _: () = assert!(egp_map::TILE_BYTES == egp_wire::TILE_BYTES);

/// Time between two looks for evidence that is too old.
const EXPIRE: Duration = Duration::from_secs(60);

/// The state of the thread.
pub(crate) struct Keeper {
    pub store: Store,
    pub intake: Arc<Intake>,
    pub network: Putter,
    pub folder: Option<PathBuf>,
    pub started: Instant,
    pub publish: Duration,
    pub save: Duration,
}

/// The two clocks of a service that started at `started`.
pub(crate) fn clocks(started: Instant) -> Clocks {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    Clocks {
        unix_ms: u64::try_from(since.as_millis()).unwrap_or(u64::MAX),
        now: started.elapsed().as_secs_f64(),
    }
}

impl Keeper {
    /// Runs until the intake is gone, and then writes what was not yet written. Returns the number of roads that could not
    /// be written.
    pub(crate) fn run(mut self, jobs: &Receiver<Job>) -> usize {
        self.count();
        let wait = self.publish.min(self.save);
        let (mut published, mut saved, mut expired) = (self.started, self.started, self.started);
        loop {
            match jobs.recv_timeout(wait) {
                Ok(job) => self.answer(&job),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if due(&mut published, self.publish) {
                self.publish_changes();
            }
            if due(&mut expired, EXPIRE) {
                self.store.expire(self.started.elapsed().as_secs_f64());
                self.count();
            }
            if due(&mut saved, self.save) {
                self.write();
            }
        }
        self.publish_changes();
        self.write();
        self.store.unsaved.len()
    }

    fn answer(&mut self, job: &Job) {
        self.intake.done(&job.key);
        let now = self.started.elapsed().as_secs_f64();
        match job.kind {
            QueryKind::Question => {
                let tiles = self.store.tiles(&job.key, job.index, now);
                self.intake.metrics.count("tiles");
                let encoding = "application/protobuf;egp.v1.RoadTiles";
                job.query
                    .answer(job.query.key(), tiles.encode(), encoding, None);
            }
            QueryKind::Evidence => match self.keep(job, now) {
                Ok(()) => {
                    self.intake.metrics.count("evidence");
                    self.count();
                    job.query
                        .answer(job.query.key(), Vec::new(), "text/plain", None);
                }
                Err(error) => self.intake.refuse(&job.query, &error),
            },
        }
    }

    fn keep(&mut self, job: &Job, now: f64) -> Result<(), WireError> {
        let evidence = TileEvidence::decode(&job.query.payload())?;
        let tile = Tile::from_bytes(&evidence.rows)
            .map_err(|error| WireError::permanent(Code::InvalidField, error.to_string()))?;
        let at = now - f64::from(evidence.age_ms) / 1e3;
        Ok(self.store.add(&job.key, job.index, tile, at, now)?)
    }

    /// Publishes which tiles have new evidence.
    fn publish_changes(&mut self) {
        for (road, tiles) in self.store.take_changed() {
            let (fleet, name) = &road;
            tracing::debug!(%fleet, road = %name, tiles = tiles.len(), "changed");
            let message = encode_tiles_changed(tiles.into_iter().collect());
            self.network.put(&road_keys::changed(fleet, name), message);
        }
    }

    /// Writes the roads that changed, if the map has a folder.
    fn write(&mut self) {
        let mut unsaved = mem::take(&mut self.store.unsaved);
        let Some(folder) = &self.folder else {
            return;
        };
        let clocks = clocks(self.started);
        // A road that could not be written is tried again.
        unsaved.retain(|road| {
            let saved = file::save(folder, road, self.store.road(road), clocks);
            self.intake.metrics.wrote(saved.is_ok());
            if let Err(error) = &saved {
                tracing::error!(%error, "a road was not written");
            }
            saved.is_err()
        });
        self.store.unsaved = unsaved;
        self.count();
    }

    fn count(&self) {
        let gauge = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
        self.intake
            .metrics
            .contributions
            .set(gauge(self.store.contributions()));
        self.intake.metrics.roads.set(gauge(self.store.roads()));
        if self.folder.is_some() {
            let unsaved = gauge(self.store.unsaved.len());
            self.intake.metrics.unsaved.set(unsaved);
        }
    }
}

/// Whether `period` has passed since `last`, which then becomes now.
fn due(last: &mut Instant, period: Duration) -> bool {
    let now = Instant::now();
    let due = now.duration_since(*last) >= period;
    if due {
        *last = now;
    }
    due
}
