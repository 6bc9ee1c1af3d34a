//! Which trace a control step belongs to, and whether the trace is written.

use std::fmt;

use serde::{Serialize, Serializer};
use sha2::{Digest as _, Sha256};
use thiserror::Error;

/// The first bytes of a request, which are hashed. They have the sequence number, the measured state and the applied input,
/// so that two requests of a vehicle that agree in them are the same request; the rest would only cost time.
const HEAD: usize = 512;

/// A trace: all spans of one control step. Shown as 32 hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TraceId(pub [u8; 16]);

/// A span within its trace. Shown as 16 hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SpanId(pub [u8; 8]);

impl fmt::Display for TraceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Hexadecimal(&self.0).fmt(f)
    }
}

impl fmt::Display for SpanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Hexadecimal(&self.0).fmt(f)
    }
}

impl Serialize for TraceId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl Serialize for SpanId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Shows bytes as hexadecimal digits.
pub(crate) struct Hexadecimal<'a>(pub(crate) &'a [u8]);

impl fmt::Display for Hexadecimal<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// The identities of one control step, which vehicle and service compute independently of each other.
///
/// With $h$ the SHA-256 of `egp.v1 trace`, a zero byte, `FLEET/VEHICLE`, a zero byte and the first 512 bytes of the request,
/// the trace id is bytes 0 to 15 of $h$, and the id of the vehicle's span bytes 16 to 23. The id of any other span is
/// bytes 0 to 7 of the SHA-256 of `egp.v1 span`, a zero byte, the trace id, the replica's name, a zero byte and the span's
/// name. A sender that wanted a certain trace id would have to find a request with this hash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepIds {
    trace: TraceId,
    root: SpanId,
}

impl StepIds {
    /// The identities of the step for which this vehicle sent these bytes as its request.
    pub fn new(fleet: &str, vehicle: &str, request: &[u8]) -> Self {
        let digest: [u8; 32] = Sha256::new()
            .chain_update(b"egp.v1 trace\0")
            .chain_update(fleet)
            .chain_update(b"/")
            .chain_update(vehicle)
            .chain_update([0])
            .chain_update(request.get(..HEAD).unwrap_or(request))
            .finalize()
            .into();
        let (mut trace, mut root) = ([0; 16], [0; 8]);
        trace.copy_from_slice(&digest[..16]);
        root.copy_from_slice(&digest[16..24]);
        Self {
            trace: TraceId(trace),
            root: SpanId(root),
        }
    }

    /// The trace.
    pub fn trace(&self) -> TraceId {
        self.trace
    }

    /// The span of the whole step, which the vehicle writes.
    pub fn root(&self) -> SpanId {
        self.root
    }

    /// The span with this name that concerns this replica.
    pub fn span(&self, replica: &str, name: &str) -> SpanId {
        let digest: [u8; 32] = Sha256::new()
            .chain_update(b"egp.v1 span\0")
            .chain_update(self.trace.0)
            .chain_update(replica)
            .chain_update([0])
            .chain_update(name)
            .finalize()
            .into();
        let mut id = [0; 8];
        id.copy_from_slice(&digest[..8]);
        SpanId(id)
    }
}

/// A share of traces is out of range.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("`traces_share` must be from 0 to 1, got {0}")]
pub struct ShareError(pub f64);

/// The share of all traces that is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share(f64);

impl Share {
    /// A share from 0 (no trace) to 1 (all traces).
    ///
    /// # Errors
    /// [`ShareError`] for another number.
    pub fn new(share: f64) -> Result<Self, ShareError> {
        if (0.0..=1.0).contains(&share) {
            Ok(Self(share))
        } else {
            Err(ShareError(share))
        }
    }

    /// Whether the trace is among this share. As the samplers `TraceIdRatioBased` of `OpenTelemetry` do, it reads the last 8
    /// bytes of the id as a big-endian number and compares it with the share; a larger share has all traces of a smaller one.
    pub fn contains(self, trace: TraceId) -> bool {
        let mut low = [0; 8];
        low.copy_from_slice(&trace.0[8..]);
        // 53 bits are exact as f64.
        let fraction = (u64::from_be_bytes(low) >> 11) as f64 * 2f64.powi(-53);
        fraction < self.0
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_those_of_another_implementation() {
        // Python: hashlib.sha256(b"egp.v1 trace\0depot/car-7\0" + request[:512]).hexdigest(), and
        // hashlib.sha256(b"egp.v1 span\0" + bytes.fromhex(trace) + b"garage-1\0egp.ask").hexdigest()[:16]
        let request: Vec<u8> = (0..=255).cycle().take(700).collect();
        let ids = StepIds::new("depot", "car-7", &request);
        assert_eq!(ids.trace().to_string(), "25228463d01eb743e514bba79f09b8b3");
        assert_eq!(ids.root().to_string(), "c5357f1c7fb98036");
        assert_eq!(
            ids.span("garage-1", "egp.ask").to_string(),
            "908f6a307ba38231"
        );
        assert_eq!(
            StepIds::new("a", "b", b"short").trace().to_string(),
            "e4bc3e60fb366e9b9a7f7c37395ad089"
        );
    }

    #[test]
    fn the_head_of_the_request_decides() {
        let ids = |request: &[u8]| StepIds::new("depot", "car-7", request);
        let mut request = vec![7; 600];
        let before = ids(&request);
        request[599] = 8;
        assert_eq!(ids(&request), before);
        request[511] = 8;
        assert_ne!(ids(&request).trace(), before.trace());
        assert_ne!(StepIds::new("depot", "car-8", &[7; 600]), before);
    }

    #[test]
    fn spans_of_a_trace_have_ids_of_their_own() {
        let ids = StepIds::new("depot", "car-7", b"request");
        let all = [
            ids.root(),
            ids.span("a", "egp.ask"),
            ids.span("b", "egp.ask"),
            ids.span("a", "egp.request"),
        ];
        for (index, id) in all.iter().enumerate() {
            assert!(!all[..index].contains(id));
        }
    }

    #[test]
    fn shares_are_compared_with_the_last_bytes_of_the_id() {
        let with = |low: u64| {
            let mut id = [0xff; 16];
            id[8..].copy_from_slice(&low.to_be_bytes());
            TraceId(id)
        };
        let quarter = Share::new(0.25).unwrap();
        assert!(quarter.contains(with((1 << 62) - 1)));
        assert!(!quarter.contains(with(1 << 62)));
        assert!(Share::new(1.0).unwrap().contains(with(u64::MAX)));
        assert!(!Share::new(0.0).unwrap().contains(with(0)));
        for wrong in [-0.1, 1.1, f64::NAN] {
            assert!(
                Share::new(wrong)
                    .unwrap_err()
                    .to_string()
                    .contains("from 0 to 1")
            );
        }
    }

    #[test]
    fn about_the_share_of_all_traces_is_chosen() {
        let tenth = Share::new(0.1).unwrap();
        let chosen = (0..10_000_u32).filter(|number| {
            tenth.contains(StepIds::new("depot", "a", &number.to_le_bytes()).trace())
        });
        // The standard deviation of the count is 30.
        let count = chosen.count();
        assert!((880..1120).contains(&count), "{count}");
    }
}
