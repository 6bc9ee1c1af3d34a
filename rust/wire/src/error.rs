//! Why a message is not valid ([`Invalid`]), and the error that is sent to the client ([`WireError`]).

use prost::Message as _;
use thiserror::Error;

use crate::proto;
pub use crate::proto::error::Code;

/// Why bytes are not a valid message.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Invalid {
    /// Larger than [`crate::limits::MESSAGE_BYTES`].
    #[error("the message has {actual} bytes, at most {limit} are accepted")]
    TooLarge {
        /// Bytes accepted.
        limit: usize,
        /// Bytes of the message.
        actual: usize,
    },
    /// Not a protobuf encoding of the message.
    #[error("not an egp.v1 message: {0}")]
    Malformed(#[from] prost::DecodeError),
    /// Another version of the messages.
    #[error("{}", other_version(*actual))]
    Version {
        /// Version of the message.
        actual: u32,
    },
    /// A field whose shape or value is not valid.
    #[error("{field}: {reason}")]
    Field {
        /// Name as in the `.proto`.
        field: &'static str,
        /// What was expected and what came.
        reason: String,
    },
}

fn other_version(actual: u32) -> String {
    let own = crate::VERSION;
    if actual == 0 {
        format!("the message is empty or has no `version`; that of this program is {own}")
    } else {
        format!(
            "the message has version {actual}, and this program has version {own}; update the older program"
        )
    }
}

impl Invalid {
    /// The error about one field, named as in the `.proto`.
    pub fn field(field: &'static str, reason: impl Into<String>) -> Self {
        Self::Field {
            field,
            reason: reason.into(),
        }
    }
}

/// The code in lower case without its prefix, for example `too_late`, as metrics, logs and programs show it.
pub fn code_name(code: Code) -> &'static str {
    match code {
        Code::Unspecified => "unspecified",
        Code::Malformed => "malformed",
        Code::Version => "version",
        Code::InvalidField => "invalid_field",
        Code::UnknownLibrary => "unknown_library",
        Code::Overloaded => "overloaded",
        Code::Superseded => "superseded",
        Code::TooLate => "too_late",
        Code::Draining => "draining",
        Code::Unauthenticated => "unauthenticated",
        Code::Internal => "internal",
    }
}

/// The error that is sent to the client.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("{}{detail}", if field.is_empty() { String::new() } else { format!("{field}: ") })]
pub struct WireError {
    /// What kind of error.
    pub code: Code,
    /// Whether another attempt, at this or another replica, may succeed.
    pub retryable: bool,
    /// Time to wait before another attempt, microseconds; 0 if waiting makes no difference.
    pub retry_after_us: u32,
    /// The field at fault, as named in the `.proto`; empty when none is.
    pub field: String,
    /// What was expected, what came, what to try.
    pub detail: String,
}

impl WireError {
    /// An error at which another attempt may succeed, after `retry_after_us`.
    pub fn retryable(code: Code, retry_after_us: u32, detail: impl Into<String>) -> Self {
        Self {
            code,
            retryable: true,
            retry_after_us,
            field: String::new(),
            detail: detail.into(),
        }
    }

    /// An error that the same request would get again.
    pub fn permanent(code: Code, detail: impl Into<String>) -> Self {
        Self {
            code,
            retryable: false,
            retry_after_us: 0,
            field: String::new(),
            detail: detail.into(),
        }
    }

    /// The name of the code ([`code_name`]).
    pub fn code_name(&self) -> &'static str {
        code_name(self.code)
    }

    /// Bytes of an `egp.v1.Error`.
    pub fn encode(&self) -> Vec<u8> {
        proto::Error {
            code: self.code.into(),
            retryable: self.retryable,
            retry_after_us: self.retry_after_us,
            field: self.field.clone(),
            detail: self.detail.clone(),
        }
        .encode_to_vec()
    }

    /// Reads an `egp.v1.Error`. A code that this version does not have becomes [`Code::Unspecified`]. Texts have at most 2000
    /// characters, and control characters in them are replaced.
    ///
    /// # Errors
    /// [`Invalid`] if the bytes are not such a message.
    pub fn decode(bytes: &[u8]) -> Result<Self, Invalid> {
        let error = proto::Error::decode(bytes)?;
        Ok(Self {
            code: error.code(),
            retryable: error.retryable,
            retry_after_us: error.retry_after_us,
            field: printable(&error.field),
            detail: printable(&error.detail),
        })
    }
}

/// The first 2000 characters of a text of another program, with U+FFFD in place of control characters, which would command the
/// terminal that shows it.
pub(crate) fn printable(text: &str) -> String {
    let shown = text.chars().take(2000);
    shown
        .map(|c| if c.is_control() { '\u{fffd}' } else { c })
        .collect()
}

impl From<Invalid> for WireError {
    fn from(invalid: Invalid) -> Self {
        match invalid {
            Invalid::Field { field, reason } => Self {
                field: field.to_owned(),
                ..Self::permanent(Code::InvalidField, reason)
            },
            Invalid::Version { .. } => Self::permanent(Code::Version, invalid.to_string()),
            Invalid::TooLarge { .. } | Invalid::Malformed(_) => {
                Self::permanent(Code::Malformed, invalid.to_string())
            }
        }
    }
}
