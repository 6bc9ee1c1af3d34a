//! Tests of paths, speed profiles and track files.

mod formats;
mod horizon;
mod parts;
mod path;
mod planner;
mod speed;
mod tracks;
