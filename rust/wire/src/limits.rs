//! Sizes above which a message is an error before its numbers are read. They fit the largest request that the service is
//! made for.

/// Bytes of an encoded message.
pub const MESSAGE_BYTES: usize = 256 * 1024;
/// Members of a library, N.
pub const MEMBERS: usize = 64;
/// Inputs of a plan, T.
pub const HORIZON: usize = 128;
/// Transitions of the history, K.
pub const HISTORY: usize = 64;
