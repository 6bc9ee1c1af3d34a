//! Secret keys of vehicles, with which a vehicle and its service prove who sent a question and an answer.
//!
//! Both hold the same 32 bytes. A *tag* is HMAC-SHA-256 of these bytes, concatenated:
//!
//! | tag of | bytes |
//! |---|---|
//! | a question | `egp.v1 question`, 0, the key expression, 0, `run` and `number` (8 bytes each, little-endian), the payload |
//! | its answer | `egp.v1 answer`, 0, the tag of the question, the payload |
//!
//! The tag of an answer therefore holds for one vehicle, one replica, one sequence number and one request only.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use hmac::{Hmac, KeyInit as _, Mac as _};
use prost::Message as _;
use sha2::Sha256;
use thiserror::Error;

use crate::files::read_text;
use crate::hex::from_hex;
use crate::keys::Name;
use crate::proto;

/// Length of a key and of a tag in bytes.
const LENGTH: usize = 32;

/// HMAC-SHA-256 of a question or an answer.
pub type Tag = [u8; LENGTH];

/// The secret key of one vehicle.
#[derive(Clone, PartialEq, Eq)]
pub struct VehicleKey([u8; LENGTH]);

/// A key is not shown in logs.
impl fmt::Debug for VehicleKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("VehicleKey(..)")
    }
}

impl VehicleKey {
    /// The tag of a question on `key`; `run` and `number` are those of its [`Seal`].
    pub fn question(&self, key: &str, run: u64, number: u64, payload: &[u8]) -> Tag {
        self.question_mac(key, run, number, payload)
            .finalize()
            .into_bytes()
            .into()
    }

    /// Whether a seal belongs to this question on `key`; the comparison takes the same time for any tag.
    pub fn is_question(&self, key: &str, seal: &Seal, payload: &[u8]) -> bool {
        self.question_mac(key, seal.run, seal.number, payload)
            .verify_slice(&seal.tag)
            .is_ok()
    }

    /// The tag of the answer `payload` to the question with the tag `question`.
    pub fn answer(&self, question: &Tag, payload: &[u8]) -> Tag {
        self.answer_mac(question, payload)
            .finalize()
            .into_bytes()
            .into()
    }

    /// Whether `tag` belongs to the answer `payload` to the question with the tag `question`.
    pub fn is_answer(&self, question: &Tag, payload: &[u8], tag: &[u8]) -> bool {
        self.answer_mac(question, payload).verify_slice(tag).is_ok()
    }

    fn question_mac(&self, key: &str, run: u64, number: u64, payload: &[u8]) -> Hmac<Sha256> {
        self.mac(b"egp.v1 question\0")
            .chain_update(key)
            .chain_update([0])
            .chain_update(run.to_le_bytes())
            .chain_update(number.to_le_bytes())
            .chain_update(payload)
    }

    fn answer_mac(&self, question: &Tag, payload: &[u8]) -> Hmac<Sha256> {
        self.mac(b"egp.v1 answer\0")
            .chain_update(question)
            .chain_update(payload)
    }

    fn mac(&self, label: &[u8]) -> Hmac<Sha256> {
        // HMAC pads a key to the block of its hash, which is 64 bytes for SHA-256.
        let mut block = [0; 64];
        block[..LENGTH].copy_from_slice(&self.0);
        Hmac::<Sha256>::new(&block.into()).chain_update(label)
    }
}

/// The attachment of a vehicle's question: who asks, and the tag that proves it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seal {
    /// Fleet and name of the vehicle.
    pub vehicle: (Name, Name),
    /// Random number that the client drew when it started.
    pub run: u64,
    /// Number of the question in this run; it increases with each question.
    pub number: u64,
    /// [`VehicleKey::question`].
    pub tag: Tag,
}

impl Seal {
    /// Bytes of an `egp.v1.Seal`.
    pub fn encode(&self) -> Vec<u8> {
        let (fleet, vehicle) = &self.vehicle;
        proto::Seal {
            fleet: fleet.to_string(),
            vehicle: vehicle.to_string(),
            run: self.run,
            number: self.number,
            tag: self.tag.to_vec(),
        }
        .encode_to_vec()
    }

    /// Reads an `egp.v1.Seal`; `None` if the bytes are none.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let seal = proto::Seal::decode(bytes).ok()?;
        Some(Self {
            vehicle: (seal.fleet.parse().ok()?, seal.vehicle.parse().ok()?),
            run: seal.run,
            number: seal.number,
            tag: seal.tag.try_into().ok()?,
        })
    }
}

/// Why a text holds no keys of vehicles.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum KeyError {
    /// A line that is not a vehicle with its key.
    #[error(
        "line {0}: expected FLEET/VEHICLE and a key of 64 hexadecimal digits; `egp keys` writes such files"
    )]
    Line(usize),
    /// Two keys of one vehicle.
    #[error("line {0}: this vehicle has a key already")]
    Twice(usize),
    /// No line has a key.
    #[error(
        "there is no key in it, so that every request would get an error; `egp keys` writes such files"
    )]
    Empty,
    /// The vehicle is not there.
    #[error("there is no key of {fleet}/{vehicle} among {count}; `egp keys` makes one")]
    Missing {
        /// Its fleet.
        fleet: Name,
        /// Its name.
        vehicle: Name,
        /// Number of keys.
        count: usize,
    },
}

/// Why a file of keys cannot be used.
#[derive(Debug, Error)]
pub enum KeyFileError {
    /// The file cannot be read.
    #[error("cannot read the keys of the vehicles {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The file holds no such keys.
    #[error("{path}: {source}")]
    Content {
        /// The file.
        path: String,
        /// What is wrong.
        source: KeyError,
    },
}

/// The keys of several vehicles: a text with a line `FLEET/VEHICLE KEY` for each. Lines that begin with `#` are comments.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct KeyRing(BTreeMap<(Name, Name), VehicleKey>);

impl KeyRing {
    /// Reads a file.
    ///
    /// # Errors
    /// [`KeyFileError`] naming the file.
    pub fn read(path: &Path) -> Result<Self, KeyFileError> {
        let name = || path.display().to_string();
        let text = read_text(path).map_err(|source| KeyFileError::Read {
            path: name(),
            source,
        })?;
        Self::parse(&text).map_err(|source| KeyFileError::Content {
            path: name(),
            source,
        })
    }

    /// Reads the text.
    ///
    /// # Errors
    /// [`KeyError`] naming the line. No message contains a key.
    pub fn parse(text: &str) -> Result<Self, KeyError> {
        let mut keys = BTreeMap::new();
        for (number, line) in (1..).zip(text.lines()) {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let (vehicle, key) = entry(line).ok_or(KeyError::Line(number))?;
            if keys.insert(vehicle, key).is_some() {
                return Err(KeyError::Twice(number));
            }
        }
        Ok(Self(keys))
    }

    /// The number of vehicles that have a key.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether it has no key.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The key of a vehicle.
    ///
    /// # Errors
    /// [`KeyError::Missing`].
    pub fn get(&self, fleet: &Name, vehicle: &Name) -> Result<&VehicleKey, KeyError> {
        let own = (fleet.clone(), vehicle.clone());
        self.0.get(&own).ok_or_else(|| KeyError::Missing {
            fleet: fleet.clone(),
            vehicle: vehicle.clone(),
            count: self.0.len(),
        })
    }
}

fn entry(line: &str) -> Option<((Name, Name), VehicleKey)> {
    let (vehicle, digits) = line.split_once(char::is_whitespace)?;
    let (fleet, vehicle) = vehicle.split_once('/')?;
    Some((
        (fleet.parse().ok()?, vehicle.parse().ok()?),
        VehicleKey(from_hex(digits.trim())?),
    ))
}
