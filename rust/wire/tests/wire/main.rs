//! Messages on the wire: what is written, what is read, and what is an error.
#![allow(clippy::unwrap_used, clippy::panic)]

mod answers;
mod borders;
mod errors;
mod golden;
mod properties;
mod protobuf;
mod replace;
mod road;
mod seals;

/// The message with a field behind it that it does not have, so that there are so many bytes.
fn padded(mut message: Vec<u8>, bytes: usize) -> Vec<u8> {
    message.extend([0xc2, 0x3e]); // field 1000, with a length of three bytes
    let rest = bytes - message.len() - 3;
    prost::encode_length_delimiter(rest, &mut message).unwrap();
    message.resize(bytes, 0);
    message
}
