//! The interface by which intake and workers see a query that a network delivered.

use std::borrow::Cow;

use egp_wire::WireError;

/// A query that is answered exactly once, by a reply or by an error.
pub trait Query {
    /// The key that was asked.
    fn key(&self) -> &str;

    /// The bytes that were sent.
    fn payload(&self) -> Cow<'_, [u8]>;

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
