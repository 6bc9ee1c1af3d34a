//! Storing a belief: a safetensors container with the evidence of all cells.

use std::collections::HashMap;

use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView, serialize};
use sha2::{Digest as _, Sha256};

use crate::grid::LEVELS;
use crate::{MergeSettings, RoadBelief};

const TENSOR: &str = "evidence";
const SCHEMA: &str = "egp-road-belief-3";
/// Largest difference in m between the length of a road and that of a file.
const SAME: f64 = 1e-3;
/// Largest distance in m between the points of a road and those of a file, times the scale: more than rounding, less than a
/// lane.
const SAME_PLACE: f64 = 0.5;

/// Why bytes cannot be recalled as a belief about a road.
#[derive(Debug, thiserror::Error)]
pub enum StoredBeliefError {
    /// No safetensors container, or one that is damaged.
    #[error("not a stored belief: {0}")]
    Container(#[from] SafeTensorError),
    /// A container with another content.
    #[error("not a stored belief of this version: {0}")]
    Content(String),
    /// A belief about another road.
    #[error(
        "the belief is about a road of {stored} m ({stored_kind}), this one has {length} m ({kind})"
    )]
    OtherRoad {
        /// Length in the file, m.
        stored: f64,
        /// Lap or open road, in the file.
        stored_kind: &'static str,
        /// Length of the road, m.
        length: f64,
        /// Lap or open road.
        kind: &'static str,
    },
    /// A belief about another road of the same length.
    #[error(
        "the belief is about another road of {length:.1} m: {s:.0} m from the start, that one is {distance:.1} m beside \
         this one"
    )]
    OtherShape {
        /// Length of both, m.
        length: f64,
        /// Distance from the start, m, of the place where the roads are farthest apart.
        s: f64,
        /// Distance of the roads there, m.
        distance: f64,
    },
}

impl RoadBelief {
    /// States the road's course by points in m with equal distances along it, so that [`Self::recall`] returns an error
    /// for a belief about another road of the same length.
    #[must_use]
    pub fn with_shape(mut self, points: Vec<[f64; 2]>) -> Self {
        self.shape = points;
        self
    }

    /// The evidence as bytes; equal beliefs give equal bytes.
    ///
    /// # Errors
    /// [`StoredBeliefError::Container`] if the container cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StoredBeliefError> {
        let values: Vec<u8> = (self.evidence().iter().flatten())
            .flat_map(|value| value.to_le_bytes())
            .collect();
        // One key only: the order of several would differ from run to run.
        let mut road = vec![self.length().to_string(), kind(self.closed()).to_owned()];
        road.extend(self.shape.as_flattened().iter().map(f64::to_string));
        let road = road.join(" ");
        let stated = format!("{} {road}", checksum(&road, &values));
        let metadata = HashMap::from([(SCHEMA.to_owned(), stated)]);
        let shape = vec![self.evidence().len(), LEVELS];
        let view = TensorView::new(Dtype::F64, shape, &values)?;
        Ok(serialize([(TENSOR, view)], Some(metadata))?)
    }

    /// Adds the evidence of a belief about the same road, from the bytes of [`Self::to_bytes`]. Its logarithms are multiplied by
    /// what [`MergeSettings::remaining`] gives with the default settings for the age `age` in s.
    ///
    /// # Errors
    /// [`StoredBeliefError`] if the bytes are no stored belief, are damaged, or are about another road; the belief is
    /// then unchanged.
    pub fn recall(&mut self, bytes: &[u8], age: f64) -> Result<(), StoredBeliefError> {
        let remaining = MergeSettings::default().remaining(age);
        let content = |text: &str| StoredBeliefError::Content(text.to_owned());
        let (_, header) = SafeTensors::read_metadata(bytes)?;
        let (stated, described) = (header.metadata().as_ref())
            .and_then(|metadata| metadata.get(SCHEMA)?.split_once(' '))
            .ok_or_else(|| content(&format!("its metadata have no key {SCHEMA}")))?;
        let mut road = described.split(' ');
        let (stored, stored_kind) = (road.next().unwrap_or(""), road.next().unwrap_or(""));
        let stored: f64 = (stored.parse()).map_err(|_| content("its length is not a number"))?;
        let shape: Vec<f64> = (road.map(str::parse).collect::<Result<_, _>>())
            .map_err(|_| content("a point of its road is not a number"))?;
        let stored_kind = kind(stored_kind == kind(true));
        let (cells, length, kind) = (self.evidence().len(), self.length(), kind(self.closed()));
        if (stored - length).abs() > SAME || stored_kind != kind {
            return Err(StoredBeliefError::OtherRoad {
                stored,
                stored_kind,
                length,
                kind,
            });
        }
        self.check_shape(&shape)?;
        let tensors = SafeTensors::deserialize(bytes)?;
        let tensor = tensors.tensor(TENSOR)?;
        if let [others, LEVELS] = *tensor.shape()
            && others != cells
        {
            return Err(content(&format!(
                "it has {others} cells, this belief has {cells}: it was made with another scale"
            )));
        }
        if tensor.dtype() != Dtype::F64 || tensor.shape() != [cells, LEVELS] {
            return Err(content(&format!(
                "expected {TENSOR} of f64 [{cells}, {LEVELS}], got {:?} {:?}",
                tensor.dtype(),
                tensor.shape()
            )));
        }
        let values: Vec<f64> = (tensor.data().as_chunks().0.iter())
            .map(|bytes| f64::from_le_bytes(*bytes))
            .collect();
        if let Some(value) = values
            .iter()
            .find(|value| !(f64::MIN..=0.0).contains(*value))
        {
            return Err(content(&format!("its evidence has the number {value}")));
        }
        if checksum(described, tensor.data()) != stated {
            return Err(content("its checksum does not fit, so that it is damaged"));
        }
        self.add_recalled(remaining, values.as_chunks().0);
        Ok(())
    }

    /// Errors unless a file's points are those of this road.
    fn check_shape(&self, stored: &[f64]) -> Result<(), StoredBeliefError> {
        let points = self.shape.len();
        if stored.len() != 2 * points {
            return Err(StoredBeliefError::Content(format!(
                "expected {} coordinates of its road, got {}",
                2 * points,
                stored.len()
            )));
        }
        let apart = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).hypot(a[1] - b[1]);
        let distances = (self.shape.iter().zip(stored.as_chunks().0)).map(apart);
        match distances
            .enumerate()
            .max_by(|(_, a), (_, b)| a.total_cmp(b))
        {
            Some((place, distance))
                if distance > self.scale() * SAME_PLACE || distance.is_nan() =>
            {
                Err(StoredBeliefError::OtherShape {
                    length: self.length(),
                    s: self.length() * place as f64 / points as f64,
                    distance,
                })
            }
            _ => Ok(()),
        }
    }
}

/// SHA-256 of a road's description and of the evidence, as hexadecimal digits.
fn checksum(road: &str, evidence: &[u8]) -> String {
    let digest = Sha256::new().chain_update(road).chain_update(evidence);
    let digest = digest.finalize();
    digest.iter().fold(String::new(), |digits, byte| {
        digits + &format!("{byte:02x}")
    })
}

fn kind(closed: bool) -> &'static str {
    if closed { "lap" } else { "road" }
}
