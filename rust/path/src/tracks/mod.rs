//! Built-in tracks, computed from their definition. Closed ones start at the origin along +x.

mod outline;

pub use outline::{Corner, LShape, RoundedRectangle};
