//! A line of the file: one `TracesData` of OTLP, as the specification of the OTLP file exporter has it
//! (<https://opentelemetry.io/docs/specs/otel/protocol/file-exporter/>).

use serde::Serialize;

use crate::span::{Attribute, Span};

/// The program whose spans a file has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Resource {
    /// What the program is: `egp-server` or `egp-vehicle`.
    pub service: &'static str,
    /// Which one it is: the replica, or fleet and vehicle.
    pub instance: String,
}

/// Spans as one `TracesData` of OTLP with its newline.
pub(crate) fn line(resource: &Resource, spans: &[Span]) -> serde_json::Result<Vec<u8>> {
    #[derive(Serialize)]
    #[serde(rename_all = "camelCase")]
    struct TracesData<'a> {
        resource_spans: [ResourceSpans<'a>; 1],
    }
    #[derive(Serialize)]
    #[serde(rename_all = "camelCase")]
    struct ResourceSpans<'a> {
        resource: Attributes<'a>,
        scope_spans: [ScopeSpans<'a>; 1],
    }
    #[derive(Serialize)]
    struct Attributes<'a> {
        attributes: &'a [Attribute],
    }
    #[derive(Serialize)]
    struct ScopeSpans<'a> {
        scope: Scope,
        spans: &'a [Span],
    }
    #[derive(Serialize)]
    struct Scope {
        name: &'static str,
        version: &'static str,
    }
    let version = env!("CARGO_PKG_VERSION");
    let attributes = [
        ("service.name", resource.service),
        ("service.instance.id", &resource.instance),
        ("service.version", version),
    ]
    .map(|(key, value)| Attribute {
        key,
        value: value.into(),
    });
    let data = TracesData {
        resource_spans: [ResourceSpans {
            resource: Attributes {
                attributes: &attributes,
            },
            scope_spans: [ScopeSpans {
                scope: Scope {
                    name: "egp-trace",
                    version,
                },
                spans,
            }],
        }],
    };
    let mut line = serde_json::to_vec(&data)?;
    line.push(b'\n');
    Ok(line)
}
