//! Tensors in place in a message, and their values after shape, length and finiteness were checked.

use std::fmt;

use prost::encoding::decode_varint;

use crate::{Invalid, Predictions, fields::Fields, fields::Value};

const BYTES: usize = size_of::<f64>();
/// One more dimension than any field has.
const RANK: usize = 4;

/// An `egp.v1.Tensor`, unchecked.
#[derive(Clone, Copy, Default)]
pub(crate) struct Tensor<'a> {
    /// The first [`RANK`] extents.
    shape: [usize; RANK],
    rank: usize,
    data: &'a [u8],
}

impl<'a> Tensor<'a> {
    pub(crate) fn read(field: &'static str, message: &'a [u8]) -> Result<Self, Invalid> {
        let mut tensor = Self::default();
        for part in Fields::of(message) {
            match part? {
                (1, Value::Bytes(mut packed)) => {
                    while !packed.is_empty() {
                        tensor.push(decode_varint(&mut packed)?);
                    }
                }
                (1, extent) => tensor.push(extent.uint64(field)?),
                (2, data) => tensor.data = data.bytes(field)?,
                _ => {}
            }
        }
        Ok(tensor)
    }

    fn push(&mut self, extent: u64) {
        if let Some(slot) = self.shape.get_mut(self.rank) {
            *slot = usize::try_from(extent).unwrap_or(usize::MAX);
            self.rank += 1;
        }
    }

    fn shape(&self) -> &[usize] {
        self.shape.split_at(self.rank).0
    }

    /// The values. Errors unless the shape fits the data and every value is finite.
    fn values(
        &self,
        field: &'static str,
        accepts: impl Fn(&[usize]) -> bool,
        expected: fmt::Arguments<'_>,
    ) -> Result<&'a [[u8; BYTES]], Invalid> {
        let shape = self.shape();
        if !accepts(shape) {
            return Err(Invalid::field(
                field,
                format!("expected shape {expected}, got {shape:?}"),
            ));
        }
        // Shapes were bounded by `accepts`, so the product cannot overflow.
        let needed = shape.iter().product::<usize>() * BYTES;
        if self.data.len() != needed {
            let actual = self.data.len();
            return Err(Invalid::field(
                field,
                format!("shape {shape:?} needs {needed} bytes of data, got {actual}"),
            ));
        }
        let (values, _) = self.data.as_chunks::<BYTES>();
        let finite = |value: &[u8; BYTES]| f64::from_le_bytes(*value).is_finite();
        match values.iter().position(|value| !finite(value)) {
            Some(at) => Err(Invalid::field(field, format!("value {at} is not finite"))),
            None => Ok(values),
        }
    }
}

fn row<const W: usize>(values: &[[u8; BYTES]; W]) -> [f64; W] {
    values.map(f64::from_le_bytes)
}

/// A required `[W]`.
pub(crate) fn read_array<const W: usize>(
    field: &'static str,
    tensor: Option<Tensor>,
) -> Result<[f64; W], Invalid> {
    let tensor = tensor.ok_or_else(|| Invalid::field(field, "is required and absent"))?;
    let values = tensor.values(field, |shape| shape == [W], format_args!("[{W}]"))?;
    let values = values.first_chunk();
    values
        .map(row)
        .ok_or_else(|| Invalid::field(field, format!("expected {W} values")))
}

/// An optional `[n]` with `n <= max`; absent gives an empty one.
pub(crate) fn read_vector(
    field: &'static str,
    tensor: Option<Tensor>,
    max: usize,
    out: &mut Vec<f64>,
) -> Result<(), Invalid> {
    out.clear();
    if let Some(tensor) = tensor {
        let values = tensor.values(
            field,
            |shape| matches!(shape, [n] if (1..=max).contains(n)),
            format_args!("[n] with n from 1 to {max}"),
        )?;
        out.extend(values.iter().map(|value| f64::from_le_bytes(*value)));
    }
    Ok(())
}

/// An optional `[n, W]` with `n <= max`; absent gives no row.
pub(crate) fn read_rows<const W: usize>(
    field: &'static str,
    tensor: Option<Tensor>,
    max: usize,
    out: &mut Vec<[f64; W]>,
) -> Result<(), Invalid> {
    out.clear();
    if let Some(tensor) = tensor {
        let values = tensor.values(
            field,
            |shape| matches!(shape, [n, width] if (1..=max).contains(n) && *width == W),
            format_args!("[n, {W}] with n from 1 to {max}"),
        )?;
        out.extend(values.as_chunks().0.iter().map(row));
    }
    Ok(())
}

/// An optional `[n, members, 3]` with `n <= max_rows`, `members <= max_members`; absent gives no row.
pub(crate) fn read_predictions(
    field: &'static str,
    tensor: Option<Tensor>,
    max_rows: usize,
    max_members: usize,
    out: &mut Predictions,
) -> Result<(), Invalid> {
    out.members = 0;
    out.values.clear();
    if let Some(tensor) = tensor {
        let values = tensor.values(
            field,
            |shape| {
                matches!(shape, [n, members, 3]
                    if (1..=max_rows).contains(n) && (1..=max_members).contains(members))
            },
            format_args!("[n, N, 3] with n from 1 to {max_rows}, N from 1 to {max_members}"),
        )?;
        [_, out.members, ..] = tensor.shape;
        out.values.extend(values.as_chunks().0.iter().map(row));
    }
    Ok(())
}
