//! Writing a message straight into a buffer. Fields with their default value are left out, as proto3 prescribes.

use prost::encoding::{WireType, encode_key, encode_varint, encoded_len_varint};

use crate::Predictions;

/// Appends the fields of one message; call it in the order of their tags, so that equal messages give equal bytes.
pub(crate) struct Writer<'a>(&'a mut Vec<u8>);

impl<'a> Writer<'a> {
    /// Starts a message in `out`, whose former content is cleared and whose memory is reused.
    pub(crate) fn start(out: &'a mut Vec<u8>) -> Self {
        out.clear();
        Self(out)
    }

    pub(crate) fn number(&mut self, tag: u32, value: u64) {
        if value != 0 {
            encode_key(tag, WireType::Varint, self.0);
            encode_varint(value, self.0);
        }
    }

    pub(crate) fn double(&mut self, tag: u32, value: f64) {
        if value != 0.0 {
            encode_key(tag, WireType::SixtyFourBit, self.0);
            self.0.extend(value.to_le_bytes());
        }
    }

    pub(crate) fn bytes(&mut self, tag: u32, value: &[u8]) {
        if !value.is_empty() {
            self.length(tag, value.len());
            self.0.extend_from_slice(value);
        }
    }

    /// Appends a `Tensor` of `shape`, or nothing if there are no values.
    pub(crate) fn tensor(&mut self, tag: u32, shape: &[usize], values: &[f64]) {
        const KEY: usize = 1; // tags below 16 take one byte
        if values.is_empty() {
            return;
        }
        let delimited = |length: usize| KEY + encoded_len_varint(length as u64) + length;
        let extents = shape.iter().map(|&n| encoded_len_varint(n as u64)).sum();
        let data = size_of_val(values);
        self.length(tag, delimited(extents) + delimited(data));
        self.length(1, extents);
        for &n in shape {
            encode_varint(n as u64, self.0);
        }
        self.length(2, data);
        self.0.reserve(data);
        self.0
            .extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }

    /// `[rows, W]`.
    pub(crate) fn rows<const W: usize>(&mut self, tag: u32, rows: &[[f64; W]]) {
        self.tensor(tag, &[rows.len(), W], rows.as_flattened());
    }

    /// `[rows, members, 3]`.
    pub(crate) fn predictions(&mut self, tag: u32, predictions: &Predictions) {
        let shape = [predictions.len(), predictions.members, 3];
        self.tensor(tag, &shape, predictions.values.as_flattened());
    }

    /// Appends a message of doubles with the tags 1, 2 and so on, and `list` with the tag after them.
    pub(crate) fn doubles(&mut self, tag: u32, values: &[f64], list: &[f64], last: f64) {
        const KEY: usize = 1; // tags below 16 take one byte
        let written = (values.iter().chain([&last]))
            .filter(|value| **value != 0.0)
            .count();
        let data = size_of_val(list);
        let list_size = KEY + encoded_len_varint(data as u64) + data;
        self.length(tag, written * (KEY + size_of::<f64>()) + list_size);
        let mut next = 1;
        for value in values {
            self.double(next, *value);
            next += 1;
        }
        self.length(next, data);
        self.0
            .extend(list.iter().flat_map(|value| value.to_le_bytes()));
        self.double(next + 1, last);
    }

    fn length(&mut self, tag: u32, length: usize) {
        encode_key(tag, WireType::LengthDelimited, self.0);
        encode_varint(length as u64, self.0);
    }
}
