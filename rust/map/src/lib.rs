//! The belief about the friction of a road, by place.
//!
//! A [`RoadBelief`] collects the evidence of control steps in cells along the road, and gives the friction to plan for.

// Counts and indices of cells are small.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap
)]

mod belief;
mod belief_error;
mod exchange;
mod file;
mod grid;
mod layer;
mod merge;
mod patch;
mod preview;
mod quantile;
mod recent;
mod reported;
mod tile;

pub use belief::RoadBelief;
pub use belief_error::BeliefError;
pub use exchange::TileIndexError;
pub use file::StoredBeliefError;
pub use merge::{MergeSettings, merge};
pub use tile::{TILE_BYTES, TILE_CELLS, Tile, TileError};
