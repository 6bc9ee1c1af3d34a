//! What a library may be at most; a file beyond these is refused before memory is spent on it.

/// Version of the file format; a change that old programs cannot read counts it up.
pub const SCHEMA_VERSION: u32 = 4;
/// Largest file in bytes.
pub const MAX_FILE_BYTES: usize = 1 << 29;
/// Largest safetensors header in bytes.
pub const MAX_HEADER_BYTES: usize = 1 << 20;
/// Most members.
pub const MAX_MEMBERS: usize = 256;
/// Most training points of a member.
pub const MAX_POINTS: usize = 5000;
/// Most golden points of a member.
pub const MAX_GOLDEN: usize = 1000;
/// Shortest period `dt`, s.
pub const MIN_DT: f64 = 1e-3;
/// Longest period `dt`, s.
pub const MAX_DT: f64 = 1.0;
