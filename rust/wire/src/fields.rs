//! Reading a message field by field in place, without copies and allocations.
//!
//! The generated messages of prost copy every `bytes` field, which takes too much time in a service that answers
//! thousands of requests per second. Varints, keys and skipping are prost's. If a number comes twice, the last one counts,
//! as protobuf prescribes.

use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};

use crate::{Invalid, tensor::Tensor};

/// The fields of a message, in the order they came.
pub(crate) struct Fields<'a>(&'a [u8]);

/// A field's value by its type on the wire.
#[derive(Clone, Copy)]
pub(crate) enum Value<'a> {
    Varint(u64),
    Double(f64),
    Bytes(&'a [u8]),
    /// Groups and four-byte numbers, which no message has.
    Other,
}

impl<'a> Fields<'a> {
    pub(crate) fn of(message: &'a [u8]) -> Self {
        Self(message)
    }

    fn read(&mut self) -> Result<(u32, Value<'a>), Invalid> {
        let (tag, wire_type) = decode_key(&mut self.0)?;
        let start = self.0;
        skip_field(wire_type, tag, &mut self.0, DecodeContext::default())?;
        let (mut field, _) = start.split_at(start.len() - self.0.len());
        let value = match wire_type {
            WireType::Varint => Value::Varint(decode_varint(&mut field)?),
            WireType::LengthDelimited => {
                decode_varint(&mut field)?; // the length, which skipping has checked
                Value::Bytes(field)
            }
            WireType::SixtyFourBit => field.first_chunk().map_or(Value::Other, |bytes| {
                Value::Double(f64::from_le_bytes(*bytes))
            }),
            _ => Value::Other,
        };
        Ok((tag, value))
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u32, Value<'a>), Invalid>;

    /// Ends at the first error, because the bytes behind it have no meaning.
    fn next(&mut self) -> Option<Self::Item> {
        if self.0.is_empty() {
            return None;
        }
        let field = self.read();
        if field.is_err() {
            self.0 = &[];
        }
        Some(field)
    }
}

impl<'a> Value<'a> {
    pub(crate) fn uint64(self, field: &'static str) -> Result<u64, Invalid> {
        match self {
            Self::Varint(value) => Ok(value),
            _ => Err(mistyped(field)),
        }
    }

    /// The low 32 bits, as protobuf prescribes.
    pub(crate) fn uint32(self, field: &'static str) -> Result<u32, Invalid> {
        let [a, b, c, d, ..] = self.uint64(field)?.to_le_bytes();
        Ok(u32::from_le_bytes([a, b, c, d]))
    }

    pub(crate) fn bool(self, field: &'static str) -> Result<bool, Invalid> {
        Ok(self.uint64(field)? != 0)
    }

    pub(crate) fn double(self, field: &'static str) -> Result<f64, Invalid> {
        match self {
            Self::Double(value) => Ok(value),
            _ => Err(mistyped(field)),
        }
    }

    pub(crate) fn bytes(self, field: &'static str) -> Result<&'a [u8], Invalid> {
        match self {
            Self::Bytes(value) => Ok(value),
            _ => Err(mistyped(field)),
        }
    }

    pub(crate) fn text(self, field: &'static str) -> Result<&'a str, Invalid> {
        let text = str::from_utf8(self.bytes(field)?);
        text.map_err(|error| Invalid::field(field, error.to_string()))
    }

    /// Fills `slot`. Errors if it is full, because two tensors of one name are ambiguous.
    pub(crate) fn tensor(
        self,
        field: &'static str,
        slot: &mut Option<Tensor<'a>>,
    ) -> Result<(), Invalid> {
        once(field, slot, Tensor::read(field, self.bytes(field)?)?)
    }
}

/// Fills `slot`. Errors if it is full.
pub(crate) fn once<T>(field: &'static str, slot: &mut Option<T>, value: T) -> Result<(), Invalid> {
    match slot.replace(value) {
        Some(_) => Err(Invalid::field(field, "comes twice; send it once")),
        None => Ok(()),
    }
}

fn mistyped(field: &'static str) -> Invalid {
    Invalid::field(field, "has another type on the wire than in egp.proto")
}
