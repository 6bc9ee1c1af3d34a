//! The thread that owns the store: it answers queries, publishes changes and lets files be written.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use egp_map::Tile;
use egp_wire::{Code, TileEvidence, WireError, encode_tiles_changed, road_keys};

use super::encoding::encode;
use super::file::Clocks;
use super::intake::{Intake, Job, QueryKind};
use super::store::{Road, Store};
use super::turns::Next;
use super::writer::Writer;
use crate::query::Query;

// A tile of a message has as many bytes as a tile of a belief.
const _: () = assert!(egp_map::TILE_BYTES == egp_wire::TILE_BYTES);

/// Time between two looks for evidence that is too old.
const EXPIRE: Duration = Duration::from_secs(60);

/// Is called when the keeper has ended, also by a panic.
pub(crate) type Ended = Box<dyn Fn() + Send>;

/// Publishes a message on a key.
pub(crate) type Put = Box<dyn Fn(&str, Vec<u8>) + Send>;

/// The state of the thread.
pub(crate) struct Keeper<Q: Query> {
    pub store: Store,
    pub intake: Arc<Intake<Q>>,
    pub put: Put,
    /// Writes the roads' files; none if the map has no folder.
    pub writer: Option<Writer>,
    /// The roads of this round of writing that are not yet begun.
    pub round: BTreeSet<Road>,
    pub started: Instant,
    pub publish: Duration,
    pub save: Duration,
    pub ended: Ended,
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

impl<Q: Query> Keeper<Q> {
    /// Runs until the intake is closed and nothing waits, and then writes what was not yet written. Returns the number of
    /// roads that could not be written.
    pub(crate) fn run(mut self) -> usize {
        self.count();
        let wait = self.publish.min(self.save).min(EXPIRE);
        let [mut published, mut saved, mut expired] = [self.started; 3];
        loop {
            match self.intake.waiting.next(wait) {
                Next::Item(job) => self.answer(&job),
                Next::Nothing => {}
                Next::End => break,
            }
            if has_passed(self.publish, &mut published) {
                self.publish_changes();
            }
            if has_passed(EXPIRE, &mut expired) {
                self.store.expire(self.started.elapsed().as_secs_f64());
                self.count();
            }
            // Roads that changed since are added once all roads of the last round were begun: a road that changes again
            // and again would otherwise delay the others.
            if has_passed(self.save, &mut saved) && self.round.is_empty() {
                self.round.clone_from(&self.store.unsaved);
            }
            self.write_next();
        }
        self.publish_changes();
        self.write_all();
        self.store.unsaved.len()
    }

    fn answer(&mut self, job: &Job<Q>) {
        let now = self.started.elapsed().as_secs_f64();
        match job.kind {
            QueryKind::Question => {
                let tiles = self.store.tiles(&job.key, job.index, now);
                self.intake.metrics.answered("tiles");
                let encoding = "application/protobuf;egp.v1.RoadTiles";
                job.query
                    .answer(job.query.key(), tiles.encode(), encoding, None);
            }
            QueryKind::Evidence => match self.keep(job, now) {
                Ok(()) => {
                    self.intake.metrics.answered("evidence");
                    self.count();
                    job.query
                        .answer(job.query.key(), Vec::new(), "text/plain", None);
                }
                Err(error) => self.intake.refuse(&job.query, &error),
            },
        }
    }

    fn keep(&mut self, job: &Job<Q>, now: f64) -> Result<(), WireError> {
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
            (self.put)(&road_keys::changed(fleet, name), message);
        }
    }

    /// Takes note of a writing that has ended, and lets the next road be written.
    fn write_next(&mut self) {
        let Some(writer) = &mut self.writer else {
            self.store.unsaved.clear();
            self.round.clear();
            return;
        };
        let ended = writer.ended();
        let idle = writer.road().is_none();
        self.note(ended);
        if idle && let Some(road) = self.round.pop_first() {
            self.begin(road);
        }
    }

    /// Writes all roads that changed, and waits until that has ended.
    fn write_all(&mut self) {
        self.finish();
        for road in self.store.unsaved.clone() {
            self.begin(road);
            self.finish();
        }
    }

    /// Lets a road be written as it is now.
    fn begin(&mut self, road: Road) {
        if let Some(writer) = &mut self.writer {
            self.store.unsaved.remove(&road);
            let (tiles, clocks) = (self.store.road(&road), clocks(self.started));
            let content = tiles.map(|tiles| encode(&road, tiles, clocks));
            writer.begin(road, content);
        }
    }

    fn finish(&mut self) {
        let ended = self.writer.as_mut().and_then(Writer::finish);
        self.note(ended);
    }

    /// Takes note of whether a road was written. One that was not is tried again.
    fn note(&mut self, ended: Option<(Road, bool)>) {
        if let Some((road, written)) = ended {
            self.intake.metrics.wrote(written);
            if !written {
                self.store.unsaved.insert(road);
            }
            self.count();
        }
    }

    fn count(&self) {
        let gauge = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
        let (metrics, store) = (&self.intake.metrics, &self.store);
        metrics.contributions.set(gauge(store.contributions()));
        metrics.roads.set(gauge(store.roads()));
        if let Some(writer) = &self.writer {
            let under_way = writer.road().filter(|road| !store.unsaved.contains(road));
            let unsaved = store.unsaved.len() + usize::from(under_way.is_some());
            metrics.unsaved.set(gauge(unsaved));
        }
    }
}

/// Drops the queries that wait, also after a panic, so that they end at once at their senders, and reports that the keeper has
/// ended.
impl<Q: Query> Drop for Keeper<Q> {
    fn drop(&mut self) {
        self.intake.waiting.close();
        while let Next::Item(_) = self.intake.waiting.next(Duration::ZERO) {}
        (self.ended)();
    }
}

/// Whether `period` has passed since `last`, which then becomes now.
fn has_passed(period: Duration, last: &mut Instant) -> bool {
    let now = Instant::now();
    let passed = now.duration_since(*last) >= period;
    if passed {
        *last = now;
    }
    passed
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::sync::mpsc;
    use std::thread;

    use egp_map::{MergeSettings, TILE_BYTES};
    use prometheus_client::registry::Registry;

    use super::super::config::MapConfig;
    use super::super::file_error::{RoadFileError, system};
    use super::super::pages::MapPages;
    use super::super::writer::Content;
    use super::*;
    use crate::http::Pages as _;
    use crate::links::Links;
    use crate::query::recorded::Recorded;

    const DUE: Duration = Duration::from_millis(1);

    type Write = Box<dyn Fn(&Road, Content) -> Result<(), RoadFileError> + Send>;

    fn keeper(save: Duration, write: Write) -> Keeper<Recorded> {
        let intake = Arc::new(Intake::new());
        let woken = intake.clone();
        let writer = Writer::start(write, move || woken.waiting.wake());
        Keeper {
            store: Store::new(MergeSettings::default(), MapConfig::default().limits()),
            intake,
            put: Box::new(|_, _| {}),
            writer: Some(writer.unwrap()),
            round: BTreeSet::new(),
            started: Instant::now(),
            publish: Duration::from_secs(3600),
            save,
            ended: Box::new(|| {}),
        }
    }

    /// A query of the vehicle `a` that the keeper will answer.
    fn ask(intake: &Intake<Recorded>, rest: &str, payload: Vec<u8>) -> Recorded {
        let query = Recorded::new(&format!("egp/v1/map/depot/a/{rest}"), payload);
        intake.take(query.clone());
        query
    }

    fn evidence() -> Vec<u8> {
        let mut rows = vec![0; TILE_BYTES];
        rows[0] = 7;
        TileEvidence { age_ms: 0, rows }.encode()
    }

    fn wait_until(condition: impl Fn() -> bool) {
        let late = Instant::now() + Duration::from_secs(60);
        while !condition() {
            assert!(Instant::now() < late);
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn queries_are_answered_while_a_road_is_written() {
        let ((begun, begins), (end, ends)) = (mpsc::channel(), mpsc::channel::<()>());
        let write = move |(_, road): &Road, _: Content| {
            begun.send(road.to_string()).unwrap();
            ends.recv().unwrap();
            Ok(())
        };
        let keeper = keeper(DUE, Box::new(write));
        let intake = keeper.intake.clone();
        let running = thread::spawn(move || keeper.run());
        for road in ["ring", "park"] {
            ask(&intake, &format!("{road}/tile/0"), evidence());
        }
        let first = begins.recv().unwrap();
        for index in 1..20 {
            let query = ask(&intake, &format!("{first}/tile/{index}"), evidence());
            wait_until(|| query.sent().is_some());
            assert_eq!(query.error(), None);
        }
        assert_eq!(intake.metrics.unsaved.get(), 2);
        // The other road comes before the one that has changed again.
        end.send(()).unwrap();
        let second = begins.recv().unwrap();
        assert_ne!(first, second);
        end.send(()).unwrap();
        assert_eq!(begins.recv().unwrap(), first);
        end.send(()).unwrap();
        wait_until(|| intake.metrics.unsaved.get() == 0);
        intake.waiting.close();
        assert_eq!(running.join().unwrap(), 0);
        assert!(begins.recv().is_err());
    }

    #[test]
    fn after_a_panic_the_service_is_not_ready_and_is_told_of_it() {
        let mut keeper = keeper(DUE, Box::new(|_, _| Ok(())));
        let (told, end) = mpsc::channel();
        keeper.publish = DUE;
        keeper.put = Box::new(|_, _| panic!("this panic is part of a test"));
        keeper.ended = Box::new(move || told.send(()).unwrap());
        let intake = keeper.intake.clone();
        let pages = MapPages {
            intake: intake.clone(),
            links: Arc::new(Links::new(false, Vec::new(), &mut Registry::default())),
            serving: Arc::new(AtomicBool::new(true)),
        };
        assert_eq!(pages.not_ready(), None);
        let running = thread::spawn(move || keeper.run());
        ask(&intake, "ring/tile/0", evidence());
        end.recv_timeout(Duration::from_secs(60)).unwrap();
        assert_eq!(pages.not_ready(), Some("closed"));
        assert!(running.join().is_err());
    }

    #[test]
    fn at_the_end_all_roads_are_written_and_those_that_were_not_are_counted() {
        let (told, roads) = mpsc::channel();
        let write = move |(_, road): &Road, content: Content| {
            told.send((road.to_string(), content.is_some())).unwrap();
            let bad = road.as_str() == "ring";
            let error = || std::io::Error::from(std::io::ErrorKind::StorageFull);
            if bad {
                Err(system("ring".as_ref())(error()))
            } else {
                Ok(())
            }
        };
        let keeper = keeper(Duration::from_secs(3600), Box::new(write));
        let intake = keeper.intake.clone();
        for road in ["ring", "park", "oval"] {
            ask(&intake, &format!("{road}/tile/0"), evidence());
        }
        intake.waiting.close();
        assert_eq!(keeper.run(), 1);
        let written: Vec<_> = roads.iter().collect();
        let all = ["oval", "park", "ring"].map(|road| (road.to_owned(), true));
        assert_eq!(written, all);
        let text = intake.metrics.text();
        assert!(
            text.contains("writes_total{outcome=\"written\"} 2"),
            "{text}"
        );
        assert!(
            text.contains("writes_total{outcome=\"failed\"} 1"),
            "{text}"
        );
        assert!(text.contains("unsaved_roads 1"), "{text}");
    }
}
