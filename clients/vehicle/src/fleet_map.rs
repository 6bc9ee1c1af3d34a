//! The vehicle's side of a fleet's map, which carries out the decisions of [`FleetExchange`] over zenoh.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use egp_driver::{
    FleetAction, FleetExchange, FleetNotice, FleetSettings, FleetSettingsError, Time,
};
use egp_map::RoadBelief;
use egp_session::NetworkError;
use egp_wire::keys::{Name, NameError};
use egp_wire::road_keys::RoadKey;
use thiserror::Error;

use crate::client::FEW;
use crate::config::Access;
use crate::network::{MapEvent, MapNetwork};

/// Notices that are kept for [`FleetMap::next_notice`].
const NOTICES: usize = 64;

/// Why a vehicle cannot take part in a fleet's map.
#[derive(Debug, Error)]
pub enum FleetMapError {
    /// zenoh reports an error.
    #[error(transparent)]
    Network(#[from] NetworkError),
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] FleetSettingsError),
}

/// Configuration of a [`FleetMap`].
#[derive(Clone, Debug)]
pub struct FleetMapConfig {
    /// Fleet, vehicle and road. All vehicles of a fleet name a road alike, and each vehicle has a name of its own.
    pub road: RoadKey,
    /// How reports age, and how long answers may take, which is also how long to wait for a session.
    pub settings: FleetSettings,
    /// Map services or routers to connect to, such as `tcp/host:7448`.
    pub connect: Vec<String>,
    /// As [`crate::VehicleConfig::zenoh_file`].
    pub zenoh_file: Option<PathBuf>,
    /// As [`crate::VehicleConfig::zenoh`].
    pub zenoh: BTreeMap<String, String>,
}

impl FleetMapConfig {
    /// Defaults for a vehicle on a road that connects to these endpoints.
    ///
    /// # Errors
    /// [`NameError`] if fleet, vehicle or road is not 1 to 64 of the characters `A-Z a-z 0-9 . _ -`.
    pub fn new(
        fleet: &str,
        vehicle: &str,
        road: &str,
        connect: &[&str],
    ) -> Result<Self, NameError> {
        Ok(Self {
            road: RoadKey {
                fleet: fleet.parse()?,
                vehicle: vehicle.parse()?,
                road: road.parse()?,
            },
            settings: FleetSettings::default(),
            connect: connect.iter().map(ToString::to_string).collect(),
            zenoh_file: None,
            zenoh: BTreeMap::new(),
        })
    }

    fn access(&self) -> Access<'_> {
        Access {
            connect: &self.connect,
            patience: self.settings.timeout,
            zenoh_file: self.zenoh_file.as_deref(),
            zenoh: &self.zenoh,
        }
    }
}

/// What the other vehicles of a fleet measured about one road, for the vehicle's own belief about it.
///
/// ```no_run
/// use egp_vehicle::{FleetMap, FleetMapConfig, RoadBelief};
///
/// let mut belief = RoadBelief::new(500.0, true)?; // a closed road of 500 m
/// let config = FleetMapConfig::new("depot", "car-7", "ring", &["tcp/control.example:7448"])?;
/// let mut fleet = FleetMap::connect(&config, &mut belief)?;
/// fleet.fetch(&mut belief); // before the drive; false if no map service answers
/// loop { // in each control period, beside `belief.update(...)`
///     fleet.exchange(&mut belief);
///     # break;
/// }
/// fleet.finish(&mut belief); // after the drive
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct FleetMap {
    network: MapNetwork,
    exchange: FleetExchange,
    epoch: Instant,
    notices: VecDeque<FleetNotice>,
}

impl FleetMap {
    /// Connects. What the belief has measured or recalled so far is not sent, because its age is not known. All calls are to be
    /// given the same belief.
    ///
    /// # Errors
    /// [`FleetMapError`] if a setting is out of range, or zenoh opens no session. That no map service is there is no error.
    pub fn connect(
        config: &FleetMapConfig,
        belief: &mut RoadBelief,
    ) -> Result<Self, FleetMapError> {
        let exchange =
            FleetExchange::new(config.road.clone(), config.settings, Time::ZERO, belief)?;
        let network = MapNetwork::open(&config.access(), &exchange.publications())?;
        Ok(Self {
            network,
            exchange,
            epoch: Instant::now(),
            notices: VecDeque::new(),
        })
    }

    /// Asks for everything that is known about the road and waits for it; returns whether a map service answered. This takes
    /// at most the time-out of the settings.
    pub fn fetch(&mut self, belief: &mut RoadBelief) -> bool {
        self.exchange.fetch(self.now());
        self.wait(belief);
        !self.exchange.silent()
    }

    /// Uses what has arrived, and once a second sends what the vehicle measured; to be called once in each control period. It
    /// never waits for the network.
    pub fn exchange(&mut self, belief: &mut RoadBelief) {
        for publication in self.network.publications() {
            self.exchange.changed(&publication);
        }
        if self.network.publications_lost() {
            self.exchange.publications_lost();
        }
        // Those of a flood wait for the next periods.
        for _ in 0..FEW {
            let Some(event) = self.network.next(Duration::ZERO) else {
                break;
            };
            self.handle(event, belief);
        }
        let now = self.now();
        self.exchange.period(now, belief);
        self.carry_out();
    }

    /// Sends the last evidence and waits until it is acknowledged, at most for the time-out of the settings. Returns the number
    /// of tiles whose newest evidence was not.
    pub fn finish(&mut self, belief: &mut RoadBelief) -> usize {
        self.exchange.finish(self.now(), belief);
        self.wait(belief);
        let now = self.now();
        self.exchange.unsent(now, belief)
    }

    /// What an engineer may want to know; to be logged. The 64 newest notices are kept.
    pub fn next_notice(&mut self) -> Option<FleetNotice> {
        self.notices.pop_front()
    }

    /// Whether a map service has answered a question about the road.
    pub fn answered(&self) -> bool {
        self.exchange.answered()
    }

    /// Whether no map service replied to the last query, not even with an error.
    pub fn silent(&self) -> bool {
        self.exchange.silent()
    }

    /// The vehicles whose evidence was reported, each with the time since its newest measurement.
    pub fn origins(&self) -> BTreeMap<Name, Duration> {
        self.exchange.origins(self.now())
    }

    /// Handles events until the exchange no longer waits for any.
    fn wait(&mut self, belief: &mut RoadBelief) {
        self.carry_out();
        while let Some(wake) = self.exchange.next_wake() {
            if let Some(event) = self.network.next(wake.saturating_sub(self.now())) {
                self.handle(event, belief);
            }
            self.exchange.wake(self.now(), belief); // also while events keep coming
            self.carry_out();
        }
    }

    fn handle(&mut self, event: MapEvent, belief: &mut RoadBelief) {
        let now = self.now();
        match event {
            MapEvent::Replied(id, answer) => self.exchange.replied(now, id, &answer, belief),
            MapEvent::Refused(id, error) => self.exchange.refused(id, &error),
            MapEvent::Ended(id) => self.exchange.ended(now, id, belief),
        }
    }

    fn carry_out(&mut self) {
        while let Some(action) = self.exchange.next_action() {
            match action {
                FleetAction::Ask(query) => self.network.ask(query),
                FleetAction::Notice(notice) => {
                    if self.notices.len() == NOTICES {
                        self.notices.pop_front();
                    }
                    self.notices.push_back(notice);
                }
            }
        }
    }

    fn now(&self) -> Time {
        self.epoch.elapsed()
    }
}
