//! A span, and its form in JSON, which is that of OTLP (<https://opentelemetry.io/docs/specs/otlp/#json-protobuf-encoding>):
//! ids are hexadecimal, and 64-bit numbers are texts.

use std::ops::Range;

use serde::{Serialize, Serializer};

use crate::id::{Hexadecimal, SpanId, StepIds, TraceId};

/// The names of spans.
pub mod name {
    /// One control step, measured at the vehicle.
    pub const STEP: &str = "egp.step";
    /// A vehicle asks a replica.
    pub const ASK: &str = "egp.ask";
    /// A replica answers a request; within [`ASK`].
    pub const REQUEST: &str = "egp.request";
    /// From arrival to the queue: header, seal, admission.
    pub const RECEIVE: &str = "egp.receive";
    /// From the queue to a worker.
    pub const QUEUE: &str = "egp.queue";
    /// Decoding, control step and encoding.
    pub const SOLVE: &str = "egp.solve";
}

/// The kind of a span (`SpanKind` of OTLP).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Work within one program.
    Internal = 1,
    /// Answers a question.
    Server = 2,
    /// Asks a question.
    Client = 3,
}

impl Serialize for Kind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u8(*self as u8)
    }
}

/// The value of an attribute.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub enum Value {
    /// A text.
    #[serde(rename = "stringValue")]
    Text(String),
    /// A whole number.
    #[serde(rename = "intValue", serialize_with = "as_text")]
    Number(i64),
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<u64> for Value {
    fn from(number: u64) -> Self {
        Self::Number(i64::try_from(number).unwrap_or(i64::MAX))
    }
}

/// A SHA-256, as hexadecimal digits.
impl From<&[u8; 32]> for Value {
    fn from(digest: &[u8; 32]) -> Self {
        Self::Text(Hexadecimal(digest).to_string())
    }
}

/// An attribute of a span (`KeyValue` of OTLP).
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Attribute {
    /// Its name.
    pub key: &'static str,
    /// Its value.
    pub value: Value,
}

/// The reason why the work of a span failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure(pub String);

impl Serialize for Failure {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Status<'a> {
            message: &'a str,
            code: u8,
        }
        Status {
            message: &self.0,
            code: 2, // STATUS_CODE_ERROR
        }
        .serialize(serializer)
    }
}

/// A piece of work with its beginning and its end.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Span {
    /// The control step.
    pub trace_id: TraceId,
    /// The span itself.
    pub span_id: SpanId,
    /// The span of which it is a part; none for that of the whole step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub parent_span_id: Option<SpanId>,
    /// One of [`name`].
    pub name: &'static str,
    /// Its kind.
    pub kind: Kind,
    /// When it began, in nanoseconds since 1970-01-01 00:00 UTC.
    #[serde(serialize_with = "as_text")]
    pub start_time_unix_nano: u64,
    /// When it ended.
    #[serde(serialize_with = "as_text")]
    pub end_time_unix_nano: u64,
    /// Its attributes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub attributes: Vec<Attribute>,
    /// Why the work failed.
    #[serde(rename = "status", skip_serializing_if = "Option::is_none")]
    pub failure: Option<Failure>,
}

impl Span {
    /// The span of a whole step; `times` are in nanoseconds since 1970-01-01 00:00 UTC.
    pub fn new(ids: &StepIds, name: &'static str, kind: Kind, times: Range<u64>) -> Self {
        Self {
            trace_id: ids.trace(),
            span_id: ids.root(),
            parent_span_id: None,
            name,
            kind,
            start_time_unix_nano: times.start,
            end_time_unix_nano: times.end,
            attributes: Vec::new(),
            failure: None,
        }
    }

    /// The same span with this id.
    #[must_use]
    pub fn with_id(mut self, id: SpanId) -> Self {
        self.span_id = id;
        self
    }

    /// The same span as a part of another one.
    #[must_use]
    pub fn with_parent(mut self, parent: SpanId) -> Self {
        self.parent_span_id = Some(parent);
        self
    }

    /// The same span with one attribute more.
    #[must_use]
    pub fn with(mut self, key: &'static str, value: impl Into<Value>) -> Self {
        let value = value.into();
        self.attributes.push(Attribute { key, value });
        self
    }

    /// The same span, whose work failed for this reason.
    #[must_use]
    pub fn failed(mut self, reason: impl Into<String>) -> Self {
        self.failure = Some(Failure(reason.into()));
        self
    }
}

/// The signature is serde's.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn as_text<S: Serializer>(
    number: &impl std::fmt::Display,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_str(number)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_span_has_the_form_of_otlp() {
        let ids = StepIds::new("depot", "car-7", b"request");
        let [trace, root, ask] = [
            ids.trace().to_string(),
            ids.root().to_string(),
            ids.span("garage-1", name::ASK).to_string(),
        ];
        let whole = Span::new(&ids, name::STEP, Kind::Internal, 5..9);
        let expected = json!({
            "traceId": trace, "spanId": root, "name": "egp.step", "kind": 1,
            "startTimeUnixNano": "5", "endTimeUnixNano": "9",
        });
        assert_eq!(serde_json::to_value(&whole).unwrap(), expected);
        let asked = Span::new(&ids, name::ASK, Kind::Client, 5..u64::MAX)
            .with_id(ids.span("garage-1", name::ASK))
            .with_parent(ids.root())
            .with("egp.replica", "garage-1")
            .with("egp.sequence", u64::MAX)
            .with("egp.library", &[0xa1; 32])
            .failed("no answer");
        let expected = json!({
            "traceId": trace, "spanId": ask, "parentSpanId": root, "name": "egp.ask", "kind": 3,
            "startTimeUnixNano": "5", "endTimeUnixNano": "18446744073709551615",
            "attributes": [
                {"key": "egp.replica", "value": {"stringValue": "garage-1"}},
                {"key": "egp.sequence", "value": {"intValue": "9223372036854775807"}},
                {"key": "egp.library", "value": {"stringValue": "a1".repeat(32)}},
            ],
            "status": {"code": 2, "message": "no answer"},
        });
        assert_eq!(serde_json::to_value(&asked).unwrap(), expected);
    }
}
