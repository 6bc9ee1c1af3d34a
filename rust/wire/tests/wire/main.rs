//! Messages on the wire: what is written, what is read, and what is an error.
#![allow(clippy::unwrap_used, clippy::panic)]

mod answers;
mod borders;
mod errors;
mod golden;
mod properties;
mod protobuf;
mod road;
mod seals;
