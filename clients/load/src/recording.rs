//! The requests of a recorded run.

use std::fs;
use std::path::Path;

use egp_wire::{MessageLimits, Request};

use crate::Failure;

/// Requests in the order in which they were sent, from a file that holds for each its length as a varint and its bytes, which
/// is protobuf's delimited form. `egp load --replay run.mcap` makes such a file of a recording.
///
/// # Errors
/// A message if the file cannot be read, or holds no request or one that is not valid.
pub(crate) fn read(path: &Path) -> Result<Vec<Request>, Failure> {
    let name = path.display();
    let bytes = fs::read(path).map_err(|error| format!("cannot read {name}: {error}"))?;
    let mut rest = bytes.as_slice();
    let mut requests = Vec::new();
    while !rest.is_empty() {
        let length = prost::decode_length_delimiter(&mut rest)
            .ok()
            .filter(|length| *length <= rest.len())
            .ok_or_else(|| format!("{name}: expected requests in protobuf's delimited form"))?;
        let (message, others) = rest.split_at(length);
        let request = Request::decode(message, &MessageLimits::default());
        requests.push(request.map_err(|error| format!("{name}: a request: {error}"))?);
        rest = others;
    }
    if requests.is_empty() {
        return Err(format!("{name}: no requests").into());
    }
    Ok(requests)
}
