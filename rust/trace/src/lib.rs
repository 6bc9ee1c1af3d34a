//! Traces of control steps: spans that vehicle and service write into files, from which `OpenTelemetry` joins them.
//!
//! The trace id is not sent. Vehicle and service both compute it from the request ([`StepIds`]), and both choose the same
//! steps by it ([`Share`]). A [`TraceFile`] writes spans as lines of JSON in a thread of its own. `docs/deploying.md`,
//! section 3, describes the spans and how the Collector of `OpenTelemetry` reads the files.
//!
//! ```
//! use egp_trace::{Kind, Share, Span, StepIds, name};
//!
//! let (request, sequence) = (b"the bytes of a request", 7);
//! let ids = StepIds::new("depot", "car-7", request);
//! if Share::new(1.0)?.contains(ids.trace()) {
//!     let span = Span::new(&ids, name::REQUEST, Kind::Server, 1_000..2_000)
//!         .with_id(ids.span("garage-1", name::REQUEST))
//!         .with_parent(ids.span("garage-1", name::ASK))
//!         .with("egp.sequence", sequence);
//!     assert_eq!(span.trace_id.to_string().len(), 32);
//! }
//! # Ok::<(), egp_trace::ShareError>(())
//! ```

mod append;
mod counts;
mod file;
mod id;
mod line;
mod moment;
mod span;

pub use counts::Counts;
pub use file::{TraceError, TraceFile};
pub use id::{Share, ShareError, SpanId, StepIds, TraceId};
pub use line::Resource;
pub use moment::Moment;
pub use span::{Attribute, Failure, Kind, Span, Value, name};
