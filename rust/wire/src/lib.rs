//! The messages between a vehicle and the service: typed requests, replies and errors, their protobuf encoding, and key
//! expressions.
//!
//! Decoding is the trust boundary: a [`Request`] or [`Reply`] that `decode` returned has exact shapes, finite numbers
//! inside the declared domain and weights on the simplex. The crate contains neither network nor mathematics.
//!
//! ```
//! use egp_wire::Request;
//!
//! let request = Request {
//!     library: [7; 32],
//!     sequence: 1,
//!     budget_us: 40_000,
//!     x: [0.0, 0.0, 12.0, 0.0, 0.0, 0.0, 0.0],
//!     reference: vec![[0.0, 0.0, 12.0, 0.0]; 21],
//!     ..Request::default()
//! };
//! assert_eq!(Request::decode(&request.encode())?, request);
//! # Ok::<(), egp_wire::Invalid>(())
//! ```

mod check;
mod error;
mod fields;
mod files;
mod friction;
mod header;
mod hex;
pub mod keys;
mod library_file;
pub mod library_keys;
pub mod limits;
mod output;
mod predictions;
mod ready;
mod replace;
mod reply;
mod request;
mod road;
pub mod road_keys;
mod seal;
mod signals;
mod tensor;
mod threads;
mod writer;

pub use check::MAX_BUDGET_US;
pub use error::{Code, Invalid, WireError, code_name};
pub use files::{read_regular, read_text};
pub use friction::Friction;
pub use header::Header;
pub use hex::{from_hex, hex};
pub use library_file::LibraryFile;
pub use library_keys::LIBRARY_PART_BYTES;
pub use output::{print_line, print_notice};
pub use predictions::Predictions;
pub use proto::{Load, Status, Timing};
pub use ready::Ready;
pub use replace::{Replacement, replace_file, replaceable, sync_folder};
pub use reply::{Reply, status_name};
pub use request::{Request, check_reference, check_road_friction, check_state};
pub use road::{
    ROAD_TILES, RoadTile, RoadTiles, TILE_BYTES, TILE_ORIGINS, TILES_AT_ONCE, TileEvidence,
    TileOrigin, decode_tiles_changed, encode_tiles_changed,
};

pub use seal::{KeyError, KeyFileError, KeyRing, Seal, Tag, VehicleKey};
pub use signals::{Interrupt, not_ignored, survive_file_size_limit};
pub use threads::{ask_for_tls, set_network_threads};

/// The messages as generated from `proto/egp/v1/egp.proto`, unvalidated.
#[allow(missing_docs, clippy::pedantic)]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/egp.v1.rs"));
}

/// Serialised `google.protobuf.FileDescriptorSet` of the `.proto`, for recordings and for clients that
/// build their messages at run time.
pub const FILE_DESCRIPTOR_SET: &[u8] =
    include_bytes!(concat!(env!("OUT_DIR"), "/egp.v1.descriptors.bin"));

/// Version of the messages; a request with another one is an error.
pub const VERSION: u32 = 1;

/// State `[p_x, p_y, v_x, psi, v_y, omega, delta]` in m, m, m/s, rad, m/s, rad/s, rad.
pub type State = [f64; 7];
/// Input `[F_x, delta_dot]` in N, rad/s.
pub type Input = [f64; 2];
/// GP input `[v_x, v_y, omega, delta, F_x, delta_dot]` in m/s, m/s, rad/s, rad, N, rad/s.
pub type GpInput = [f64; 6];
/// GP output: change of `[v_x, v_y, omega]` over one period, in m/s, m/s, rad/s.
pub type GpOutput = [f64; 3];
/// Reference row `[p_x, p_y, v_x, psi]` in m, m, m/s, rad.
pub type ReferenceRow = [f64; 4];
/// Distances `[left, right]` from the reference point to the track edges, m.
pub type WidthRow = [f64; 2];
/// Friction coefficient of the road, and its standard deviation.
pub type FrictionRow = [f64; 2];
/// SHA-256 of a library file.
pub type LibraryId = [u8; 32];
