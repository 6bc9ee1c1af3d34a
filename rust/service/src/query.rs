//! The interface by which intake and workers see a query that a network delivered.

use std::borrow::Cow;

use egp_wire::WireError;

/// A query that is answered exactly once, by a reply or by an error.
pub trait Query {
    /// The key that was asked.
    fn key(&self) -> &str;

    /// Length of the payload in bytes.
    fn length(&self) -> usize;

    /// The bytes that were sent, which are copied if they came in several parts.
    fn payload(&self) -> Cow<'_, [u8]>;

    /// The attachment; empty if there is none.
    fn attachment(&self) -> Cow<'_, [u8]>;

    /// Replies on `key`, which must match the query's.
    fn answer(
        &self,
        key: &str,
        payload: Vec<u8>,
        encoding: &'static str,
        attachment: Option<Vec<u8>>,
    );

    /// Replies with an error.
    fn refuse(&self, error: &WireError);
}
