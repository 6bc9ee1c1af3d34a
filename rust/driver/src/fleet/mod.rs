//! The vehicle's side of a fleet's map, which `docs/map.md` describes: what it sends, asks and uses, and when.

mod action;
mod notice;
mod open;
mod reports;
mod settings;
mod waiting;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::mem::{replace, take};
use std::time::Duration;

use egp_map::{RoadBelief, Tile};
use egp_wire::keys::Name;
use egp_wire::road_keys::{self, RoadKey};
use egp_wire::{RoadTiles, TileEvidence, WireError, decode_tiles_changed};

pub use self::action::{FleetAction, MapQuery};
pub use self::notice::{FleetNotice, Purpose};
use self::open::{Open, Subject};
use self::reports::Reports;
pub use self::settings::{FleetSettings, FleetSettingsError};
use self::waiting::Waiting;
use crate::action::QueryId;
use crate::driver::Time;

/// Time between two exchanges.
const EXCHANGE: Duration = Duration::from_secs(1);
/// Longest time-out; zenoh's times overflow far above it.
const LONGEST: Duration = Duration::from_secs(86_400);
/// Largest number of tiles whose evidence is being sent: a slow link has room for little.
const SENDING: usize = 16;

/// Exchanges what vehicles measured about the friction of one road with a map service.
///
/// A state machine without clock, network or threads, as [`crate::Driver`] is. A transport reports each event with its time,
/// and carries out the [`FleetAction`]s after each call. [`FleetExchange::period`] is called once in each control period.
/// [`FleetExchange::fetch`] and [`FleetExchange::finish`] take longer: while [`FleetExchange::is_waiting`] the transport waits for
/// events, and calls [`FleetExchange::wake`] at [`FleetExchange::next_wake`].
///
/// All calls are given the same belief.
///
/// ```
/// use std::time::Duration;
/// use egp_driver::{FleetAction, FleetExchange, FleetSettings};
/// use egp_map::RoadBelief;
/// use egp_wire::RoadTiles;
/// use egp_wire::road_keys::RoadKey;
///
/// let mut belief = RoadBelief::new(500.0, true)?; // a closed road of 500 m
/// let road = RoadKey { fleet: "depot".parse()?, vehicle: "car-7".parse()?, road: "ring".parse()? };
/// let mut exchange = FleetExchange::new(road, FleetSettings::default(), Duration::ZERO, &mut belief)?;
///
/// exchange.fetch(Duration::ZERO);
/// let Some(FleetAction::Ask(query)) = exchange.next_action() else { unreachable!() };
/// assert_eq!(query.key, "egp/v1/map/depot/car-7/ring/tiles/0");
///
/// let now = Duration::from_millis(5);
/// exchange.replied(now, query.id, &RoadTiles::default().encode(), &mut belief); // nothing was reported yet
/// exchange.ended(now, query.id, &mut belief);
/// assert!(!exchange.is_waiting() && !exchange.silent());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct FleetExchange {
    road: RoadKey,
    settings: FleetSettings,
    tiles: u32,
    actions: VecDeque<FleetAction>,
    next_id: u64,
    open: BTreeMap<QueryId, Open>,
    reports: Reports,
    /// Tiles with new evidence, each with the time at which it was noticed.
    unsent: BTreeMap<u32, Time>,
    /// Tiles whose evidence was acknowledged, each with the same time.
    sent: BTreeMap<u32, Time>,
    /// Whether a query had no answer since the last one that had: the service may have been started again without what it had, and
    /// publications may be lost.
    missed: bool,
    /// What the last error of a service states as the time until another attempt.
    retry_after: Duration,
    /// The first and the last tile that have changed since they were asked for.
    stale: Option<(u32, u32)>,
    exchanged: Time,
    waiting: Option<Waiting>,
    answered: bool,
    silent: bool,
    noticed: BTreeSet<(&'static str, i32)>,
}

impl FleetExchange {
    /// An exchange about the road of `belief`. What the belief has measured or recalled so far is not sent, because its age is
    /// not known.
    ///
    /// Beliefs with shorter cells than 2 m exchange evidence among themselves: in keys `.250mm` follows the name of the road if
    /// its cells are at most 0.25 m long.
    ///
    /// # Errors
    /// [`FleetSettingsError`] unless the lifetime is positive and finite, the time-out at most a day, and the name of a road with
    /// short cells at most 56 characters long.
    pub fn new(
        mut road: RoadKey,
        settings: FleetSettings,
        now: Time,
        belief: &mut RoadBelief,
    ) -> Result<Self, FleetSettingsError> {
        if !(settings.lifetime > 0.0 && settings.lifetime.is_finite()) {
            return Err(FleetSettingsError::Lifetime(settings.lifetime));
        }
        if settings.timeout > LONGEST {
            return Err(FleetSettingsError::Timeout(settings.timeout));
        }
        if belief.scale() < 1.0 {
            let cell = 1e3 * belief.longest_cell();
            road.road = format!("{}.{cell:.0}mm", road.road).parse()?;
        }
        belief.take_changed();
        Ok(Self {
            road,
            settings,
            tiles: u32::try_from(belief.tiles()).unwrap_or(u32::MAX),
            actions: VecDeque::new(),
            next_id: 0,
            open: BTreeMap::new(),
            reports: Reports::new(settings.lifetime),
            unsent: BTreeMap::new(),
            sent: BTreeMap::new(),
            missed: false,
            retry_after: Duration::ZERO,
            stale: None,
            exchanged: now,
            waiting: None,
            answered: false,
            silent: false,
            noticed: BTreeSet::new(),
        })
    }

    /// The key of the service's publications about the road, each of which is an event ([`Self::changed`]).
    pub fn publications(&self) -> String {
        road_keys::changed(&self.road.fleet, &self.road.road)
    }

    /// Sends what changed and asks for what others changed, if the last exchange was a second ago, and ages a report if that
    /// is due. To be called once in each control period, after the events since the last one.
    pub fn period(&mut self, now: Time, belief: &mut RoadBelief) {
        if now.saturating_sub(self.exchanged) >= EXCHANGE {
            self.exchanged = now;
            self.send(now, belief, &BTreeSet::new());
            if let Some((first, last)) = self.stale
                && !self.asks()
            {
                self.ask(first, last, self.settings.timeout);
            }
        }
        self.reports.age(now, belief);
    }

    /// The service published that tiles of the road have new evidence.
    pub fn changed(&mut self, publication: &[u8]) {
        let tiles = match decode_tiles_changed(publication) {
            Ok(tiles) => tiles,
            Err(error) => return self.notice(FleetNotice::UnreadablePublication(error)),
        };
        if let (Some(&first), Some(&last)) = (tiles.iter().min(), tiles.iter().max())
            && first <= self.last_tile()
        {
            let (from, to) = self.stale.unwrap_or((first, last));
            self.stale = Some((first.min(from), last.max(to).min(self.last_tile())));
        }
    }

    /// The transport had no room for publications, so that any tile may have new evidence.
    pub fn publications_lost(&mut self) {
        self.stale = Some((0, self.last_tile()));
    }

    /// A query was answered. An answer that cannot be read counts as no answer.
    pub fn replied(&mut self, now: Time, id: QueryId, answer: &[u8], belief: &mut RoadBelief) {
        let Some(open) = self.open.get_mut(&id) else {
            return;
        };
        let tiles = match open.subject {
            Subject::Evidence(..) => Ok(None),
            Subject::Tiles { first, last } => {
                RoadTiles::decode_page(first, answer).map(|answer| Some((answer, last)))
            }
        };
        match tiles {
            Ok(tiles) => {
                (open.exists, open.decided) = (true, true);
                if let Some((answer, last)) = tiles {
                    self.report(now, id, answer, last, belief);
                }
            }
            Err(error) => self.notice(FleetNotice::UnreadableAnswer(error)),
        }
    }

    /// A query was answered with an error. Bytes that are no error of a service, such as zenoh's text about a time-out, are no
    /// answer.
    pub fn refused(&mut self, id: QueryId, error: &[u8]) {
        let (Some(open), Ok(error)) = (self.open.get_mut(&id), WireError::decode(error)) else {
            return;
        };
        open.exists = true;
        open.decided |= !error.retryable;
        self.retry_after = Duration::from_micros(error.retry_after_us.into());
        let purpose = match open.subject {
            Subject::Evidence(..) => Purpose::Evidence,
            Subject::Tiles { .. } => Purpose::Questions,
        };
        self.notice(FleetNotice::Refused(purpose, error));
    }

    /// No more answers to a query come. After a query that had none everything is asked for, and with the next answer everything
    /// is sent again.
    pub fn ended(&mut self, now: Time, id: QueryId, belief: &mut RoadBelief) {
        let Some(open) = self.open.remove(&id) else {
            return;
        };
        let fetching = matches!(self.waiting, Some(Waiting::Fetch { .. }));
        if !(open.exists || self.silent || fetching) {
            self.notice(FleetNotice::NoAnswer);
        }
        self.silent = !open.exists;
        match open.subject {
            Subject::Evidence(tile, noticed) if open.decided => {
                self.sent.insert(tile, noticed);
            }
            Subject::Evidence(tile, noticed) => {
                self.unsent.entry(tile).or_insert(noticed);
            }
            Subject::Tiles { .. } if open.decided => self.answered = true,
            Subject::Tiles { .. } => self.stale = Some((0, self.last_tile())),
        }
        if !open.exists {
            self.missed = true;
            self.stale = Some((0, self.last_tile()));
        } else if take(&mut self.missed) {
            for (tile, noticed) in &self.sent {
                self.unsent.entry(*tile).or_insert(*noticed);
            }
        }
        self.go_on(now, belief);
    }

    /// The next thing that the transport is to do.
    pub fn next_action(&mut self) -> Option<FleetAction> {
        self.actions.pop_front()
    }

    /// Whether a map service has answered a question about the road.
    pub fn answered(&self) -> bool {
        self.answered
    }

    /// Whether no map service replied to the last query, not even with an error.
    pub fn silent(&self) -> bool {
        self.silent
    }

    /// Number of tiles whose newest evidence no map service has acknowledged.
    pub fn unsent(&mut self, now: Time, belief: &mut RoadBelief) -> usize {
        self.note_changed(now, belief);
        let newer = |tile: &u32| self.unsent.contains_key(tile);
        self.unsent.len() + self.sending().filter(|tile| !newer(tile)).count()
    }

    /// The vehicles whose evidence was reported, each with the time since its newest measurement.
    pub fn origins(&self, now: Time) -> BTreeMap<Name, Duration> {
        self.reports.origins(now)
    }

    /// Sends tiles whose evidence changed, but for those that were `tried`, and returns which. One without an answer is sent
    /// again later.
    fn send(&mut self, now: Time, belief: &mut RoadBelief, tried: &BTreeSet<u32>) -> Vec<u32> {
        self.note_changed(now, belief);
        let sending: BTreeSet<u32> = self.sending().collect();
        let room = SENDING.saturating_sub(sending.len());
        let waits = |tile: &u32| !sending.contains(tile) && !tried.contains(tile);
        let chosen = self.unsent.keys().copied().filter(waits);
        let chosen: Vec<u32> = chosen.take(room).collect();
        for index in &chosen {
            let (Some(noticed), Ok(tile)) =
                (self.unsent.remove(index), belief.tile(*index as usize))
            else {
                continue;
            };
            let evidence = TileEvidence {
                age_ms: age_ms(noticed, now).unwrap_or(u32::MAX),
                rows: tile.bytes().to_vec(),
            };
            self.query(
                Subject::Evidence(*index, noticed),
                self.road.tile(*index),
                Some(evidence.encode()),
                self.settings.timeout,
            );
        }
        chosen
    }

    /// Notes which tiles have new evidence. Evidence whose age its message cannot state is dropped.
    fn note_changed(&mut self, now: Time, belief: &mut RoadBelief) {
        let tiles = belief.take_changed().into_iter();
        let tiles = tiles.filter_map(|tile| u32::try_from(tile).ok());
        self.unsent.extend(tiles.map(|tile| (tile, now)));
        self.unsent
            .retain(|_, noticed| age_ms(*noticed, now).is_some());
    }

    /// Asks for the tiles from `first` to `last`; an answer may have further ones.
    fn ask(&mut self, first: u32, last: u32, listen: Duration) {
        if self
            .stale
            .is_some_and(|(from, to)| first <= from && to <= last)
        {
            self.stale = None;
        }
        let key = self.road.tiles(first);
        self.query(Subject::Tiles { first, last }, key, None, listen);
    }

    /// Hands an answer to the belief, and asks on up to the tile `last`. Tiles beyond the end of the road are left out.
    fn report(
        &mut self,
        now: Time,
        id: QueryId,
        answer: RoadTiles,
        last: u32,
        belief: &mut RoadBelief,
    ) {
        let end = answer.tiles.last().map(|tile| tile.index);
        for found in answer.tiles {
            if let Ok(tile) = Tile::from_bytes(&found.rows)
                && belief.report(found.index as usize, &tile).is_ok()
            {
                self.reports.replace(found.index, tile, found.origins, now);
            }
        }
        if let Some(end) = end.filter(|end| answer.more && *end < last)
            && let Some(open) = self.open.get_mut(&id)
            && !replace(&mut open.asked_on, true)
        {
            self.ask(end + 1, last, self.settings.timeout);
        }
    }

    fn query(&mut self, subject: Subject, key: String, payload: Option<Vec<u8>>, listen: Duration) {
        let id = QueryId(self.next_id);
        self.next_id += 1;
        self.open.insert(id, Open::new(subject));
        self.actions.push_back(FleetAction::Ask(MapQuery {
            id,
            key,
            payload,
            listen,
        }));
    }

    /// Returns a notice to the transport; one of the same kind about the same error only once.
    fn notice(&mut self, notice: FleetNotice) {
        if notice.kind().is_none_or(|kind| self.noticed.insert(kind)) {
            self.actions.push_back(FleetAction::Notice(notice));
        }
    }

    /// Whether a question for tiles is open.
    fn asks(&self) -> bool {
        let mut open = self.open.values();
        open.any(|open| matches!(open.subject, Subject::Tiles { .. }))
    }

    /// Whether evidence is being sent.
    fn sends(&self) -> bool {
        self.sending().next().is_some()
    }

    /// The tiles whose evidence is being sent.
    fn sending(&self) -> impl Iterator<Item = u32> {
        self.open.values().filter_map(|open| match open.subject {
            Subject::Evidence(tile, _) => Some(tile),
            Subject::Tiles { .. } => None,
        })
    }

    fn last_tile(&self) -> u32 {
        self.tiles.saturating_sub(1)
    }
}

/// The age of evidence in ms, or `None` if its message cannot state it.
fn age_ms(noticed: Time, now: Time) -> Option<u32> {
    u32::try_from(now.saturating_sub(noticed).as_millis()).ok()
}
