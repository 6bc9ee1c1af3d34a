//! Storing a belief: a safetensors container with the evidence of all cells.

use std::collections::HashMap;

use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView, serialize};

use crate::grid::{LEVELS, Row};
use crate::{MergeSettings, RoadBelief};

const TENSOR: &str = "evidence";
const SCHEMA: &str = "egp-road-belief-1";
/// Largest difference in m between the length of a road and that of a file.
const SAME: f64 = 1e-3;

/// Bytes that are no belief about a road, or one about another.
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
}

impl RoadBelief {
    /// The evidence as bytes; equal beliefs give equal bytes.
    ///
    /// # Errors
    /// [`StoredBeliefError::Container`] if the container cannot be written.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StoredBeliefError> {
        let values: Vec<u8> = (self.evidence().iter().flatten())
            .flat_map(|value| value.to_le_bytes())
            .collect();
        let metadata = HashMap::from([(
            SCHEMA.to_owned(),
            format!("{} {}", self.length(), kind(self.closed())),
        )]);
        let shape = vec![self.evidence().len(), LEVELS];
        let view = TensorView::new(Dtype::F64, shape, &values)?;
        Ok(serialize([(TENSOR, view)], Some(metadata))?)
    }

    /// Adds the evidence of a belief about the same road, from the bytes of [`Self::to_bytes`].
    ///
    /// # Errors
    /// [`StoredBeliefError`] if the bytes are no stored belief, are damaged, or are about another road; the belief is
    /// then unchanged.
    pub fn recall(&mut self, bytes: &[u8]) -> Result<(), StoredBeliefError> {
        self.recall_aged(bytes, 0.0)
    }

    /// The same for evidence that is `age` s old and lost information with [`crate::MergeSettings::remaining`].
    ///
    /// # Errors
    /// Those of [`Self::recall`].
    pub fn recall_aged(&mut self, bytes: &[u8], age: f64) -> Result<(), StoredBeliefError> {
        let remaining = MergeSettings::default().remaining(age);
        let content = |text: &str| StoredBeliefError::Content(text.to_owned());
        let (_, header) = SafeTensors::read_metadata(bytes)?;
        let road = (header.metadata().as_ref())
            .and_then(|metadata| metadata.get(SCHEMA))
            .and_then(|road| road.split_once(' '));
        let (stored, stored_kind) =
            road.ok_or_else(|| content(&format!("its metadata have no key {SCHEMA}")))?;
        let stored: f64 = (stored.parse()).map_err(|_| content("its length is not a number"))?;
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
        let tensors = SafeTensors::deserialize(bytes)?;
        let tensor = tensors.tensor(TENSOR)?;
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
        let rows: &[Row] = values.as_chunks().0;
        for (cell, row) in rows.iter().enumerate() {
            self.add_to_cell(cell, remaining, row);
        }
        Ok(())
    }
}

fn kind(closed: bool) -> &'static str {
    if closed { "lap" } else { "road" }
}
