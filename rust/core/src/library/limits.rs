//! Version of the library's format, and the limits of its size and period. Sizes are checked before memory is allocated.

/// Version of the file format, incremented by each change that older programs cannot read.
pub(super) const SCHEMA_VERSION: u32 = 4;
/// Largest file in bytes.
pub const MAX_FILE_BYTES: usize = 1 << 29;
/// Largest safetensors header in bytes.
pub const MAX_HEADER_BYTES: usize = 1 << 20;
/// Most members.
pub(super) const MAX_MEMBERS: usize = 256;
/// Most training points of a member.
pub(super) const MAX_POINTS: usize = 5000;
/// Most golden points of a member.
pub(super) const MAX_GOLDEN: usize = 1000;
/// Most steps of the Euler method in a period.
pub(super) const MAX_EULER_STEPS: u32 = 100;
/// Shortest period `dt`, s.
pub(super) const MIN_DT: f64 = 1e-3;
/// Longest period `dt`, s.
pub(super) const MAX_DT: f64 = 1.0;
