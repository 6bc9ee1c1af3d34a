//! What a vehicle believes about the friction of a road, by place.
//!
//! A [`RoadBelief`] collects the evidence of control steps in cells along the road, and gives the friction to plan for.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts and cell indices are small and positive

mod belief;
mod file;
mod grid;

pub use belief::{BeliefError, BeliefSettings, RoadBelief};
pub use file::StoredBeliefError;
