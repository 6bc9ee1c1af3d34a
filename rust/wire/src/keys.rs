//! Key expressions; `docs/wire.md` describes them.
//!
//! Each replica has its own prefix, because zenoh does not balance queries over replicas; the client chooses one. A
//! vehicle is identified by its key and not by the payload, so that access control covers it.

use std::{fmt, str::FromStr};

use thiserror::Error;

use crate::{LibraryId, library_keys};

pub(crate) const PREFIX: &str = "egp/v1/r/";
const LIVE: &str = "egp/v1/@live/";
const LOAD: &str = "egp/v1/@load/";
const VEHICLE: &str = "egp/v1/@vehicle/";
const STEP: &str = "/step";
const NAME_MAX: usize = 64;

/// Matches the liveliness tokens of all replicas.
pub const ALL_LIVE: &str = "egp/v1/@live/*";

/// Matches the publications of all replicas' [`crate::Load`].
pub const ALL_LOADS: &str = "egp/v1/@load/*";

/// Matches the publications of all vehicles' [`crate::proto::VehicleStatus`].
pub const ALL_VEHICLES: &str = "egp/v1/@vehicle/*/*";

/// The text is not a name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "{0:?} is no name of a replica, fleet, vehicle or road: use 1 to {NAME_MAX} of A-Z a-z 0-9 . _ -"
)]
pub struct NameError(String);

/// Name of a replica, a fleet, a vehicle or a road: one chunk of a key.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(String);

impl Name {
    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for Name {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        let allowed = |c: u8| c.is_ascii_alphanumeric() || matches!(c, b'.' | b'_' | b'-');
        if (1..=NAME_MAX).contains(&text.len()) && text.bytes().all(allowed) {
            Ok(Self(text.to_owned()))
        } else {
            Err(NameError(text.to_owned()))
        }
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The key expression of a replica's queryable.
pub fn replica(replica: &Name) -> String {
    format!("{PREFIX}{replica}/**")
}

/// The key on which a vehicle asks a replica for a control step.
pub fn step(replica: &Name, fleet: &Name, vehicle: &Name) -> String {
    format!("{PREFIX}{replica}/{fleet}/{vehicle}{STEP}")
}

/// The key on which a replica answers whether it is alive (`text/plain`).
pub fn health(replica: &Name) -> String {
    format!("{PREFIX}{replica}/health")
}

/// The key on which a replica answers what it serves ([`crate::Ready`]).
pub fn ready(replica: &Name) -> String {
    format!("{PREFIX}{replica}/ready")
}

/// The key on which a replica answers its OpenMetrics text.
pub fn metrics(replica: &Name) -> String {
    format!("{PREFIX}{replica}/metrics")
}

/// Liveliness token of a replica.
pub fn live(replica: &Name) -> String {
    format!("{LIVE}{replica}")
}

/// The key on which a replica publishes its [`crate::Load`].
pub fn load(replica: &Name) -> String {
    format!("{LOAD}{replica}")
}

/// The replica to which a liveliness token belongs.
pub fn replica_of_live(key: &str) -> Option<Name> {
    key.strip_prefix(LIVE)?.parse().ok()
}

/// The replica that publishes its [`crate::Load`] on this key.
pub fn replica_of_load(key: &str) -> Option<Name> {
    key.strip_prefix(LOAD)?.parse().ok()
}

/// The key on which a vehicle publishes its [`crate::proto::VehicleStatus`].
pub fn vehicle(fleet: &Name, vehicle: &Name) -> String {
    format!("{VEHICLE}{fleet}/{vehicle}")
}

/// The key on which a vehicle answers its [`crate::proto::VehicleRoad`].
pub fn vehicle_road(fleet: &Name, vehicle: &Name) -> String {
    format!("{VEHICLE}{fleet}/{vehicle}/road")
}

/// Fleet and name of the vehicle that publishes its status on this key.
pub fn publishing_vehicle(key: &str) -> Option<(Name, Name)> {
    let (fleet, vehicle) = key.strip_prefix(VEHICLE)?.split_once('/')?;
    Some((fleet.parse().ok()?, vehicle.parse().ok()?))
}

/// The purpose of a query under a replica's prefix.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// A control step.
    Step {
        /// Fleet of the vehicle.
        fleet: Name,
        /// The vehicle.
        vehicle: Name,
    },
    /// [`health`].
    Health,
    /// [`ready`].
    Ready,
    /// [`metrics`].
    Metrics,
    /// [`library_keys::library`] or, with the number of a part, [`library_keys::library_part`].
    Library {
        /// SHA-256 of the library.
        id: LibraryId,
        /// Number of the part.
        part: Option<u32>,
    },
}

/// Reads the key of a query, or returns `None` for a key that a replica does not answer.
pub fn parse(key: &str) -> Option<Target> {
    let (_replica, rest) = key.strip_prefix(PREFIX)?.split_once('/')?;
    match rest {
        "health" => Some(Target::Health),
        "ready" => Some(Target::Ready),
        "metrics" => Some(Target::Metrics),
        _ => {
            let (first, behind) = rest.split_once('/')?;
            if let Some(vehicle) = behind.strip_suffix(STEP) {
                return Some(Target::Step {
                    fleet: first.parse().ok()?,
                    vehicle: vehicle.parse().ok()?,
                });
            }
            if first != library_keys::LIBRARY {
                return None;
            }
            let (id, part) = library_keys::parse(behind)?;
            Some(Target::Library { id, part })
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn each_key_is_the_one_that_the_protocol_names() {
        let main: Name = "main".parse().unwrap();
        assert_eq!(main.as_str(), "main");
        assert_eq!(replica(&main), "egp/v1/r/main/**");
        assert_eq!(health(&main), "egp/v1/r/main/health");
        assert_eq!(ready(&main), "egp/v1/r/main/ready");
        assert_eq!(metrics(&main), "egp/v1/r/main/metrics");
        assert_eq!(live(&main), "egp/v1/@live/main");
        assert_eq!(load(&main), "egp/v1/@load/main");
        assert_eq!(vehicle(&main, &main), "egp/v1/@vehicle/main/main");
        assert_eq!(vehicle_road(&main, &main), "egp/v1/@vehicle/main/main/road");
    }

    #[test]
    fn keys_read_back() {
        let [here, fleet, vehicle] = ["r1", "depot", "car-7"].map(|name| name.parse().unwrap());
        assert_eq!(
            step(&here, &fleet, &vehicle),
            "egp/v1/r/r1/depot/car-7/step"
        );
        assert_eq!(
            parse(&step(&here, &fleet, &vehicle)),
            Some(Target::Step {
                fleet: fleet.clone(),
                vehicle: vehicle.clone()
            })
        );
        assert_eq!(parse(&ready(&here)), Some(Target::Ready));
        assert_eq!(parse(&health(&here)), Some(Target::Health));
        assert_eq!(parse(&metrics(&here)), Some(Target::Metrics));
        assert_eq!(parse(&replica(&here)), None);
        assert_eq!(parse("egp/v1/r/r1/depot/step"), None);
        assert_eq!(parse("egp/v1/r/r1/a/b/c/step"), None);
        assert_eq!(replica_of_live(&live(&here)), Some(here.clone()));
        assert_eq!(replica_of_load(&load(&here)), Some(here));
        assert_eq!(
            publishing_vehicle(&super::vehicle(&fleet, &vehicle)),
            Some((fleet.clone(), vehicle.clone()))
        );
        assert_eq!(publishing_vehicle(&vehicle_road(&fleet, &vehicle)), None);
    }

    #[test]
    fn names_are_single_literal_chunks() {
        for bad in ["", "a/b", "*", "$*", "@x", "a b", &"n".repeat(65)] {
            assert!(bad.parse::<Name>().is_err(), "{bad:?}");
        }
        let longest = "A-z_0.9n".repeat(8);
        assert_eq!(longest.parse::<Name>().unwrap().to_string(), longest);
    }
}
