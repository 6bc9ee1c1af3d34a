//! Sizes above which a message is an error before its numbers are read.

/// Size limits applied while decoding. The defaults fit the largest request that the service is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageLimits {
    /// Bytes of an encoded message.
    pub message_bytes: usize,
    /// Members of a library, N.
    pub members: usize,
    /// Inputs of a plan, T.
    pub horizon: usize,
    /// Transitions of the history, K.
    pub history: usize,
}

impl MessageLimits {
    /// The default limits.
    pub const DEFAULT: Self = Self {
        message_bytes: 256 * 1024,
        members: 64,
        horizon: 128,
        history: 64,
    };
}

impl Default for MessageLimits {
    fn default() -> Self {
        Self::DEFAULT
    }
}
