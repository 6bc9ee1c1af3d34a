//! Errors of paths, profiles and references.

pub(crate) use egp_parameters::range::check;
use egp_parameters::{OutOfRange, SurfaceError};
use thiserror::Error;

/// An invalid input; the message gives the expected and the given value and its location.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PathError {
    /// Fewer waypoints than a spline needs.
    #[error("expected at least 4 distinct points, got {0}")]
    TooFewPoints(usize),
    /// A coordinate or width is not finite, or is outside its range.
    #[error("expected finite {what}, got {value} at index {index}")]
    NotFinite {
        /// Description of the value.
        what: &'static str,
        /// Index of its row.
        index: usize,
        /// The value.
        value: f64,
    },
    /// Two neighbouring waypoints are the same point.
    #[error("points {0} and {next} are the same; remove one of them", next = .0 + 1)]
    RepeatedPoint(usize),
    /// Two neighbouring waypoints whose distance is lost by rounding in the length of the path before them.
    #[error(
        "two neighbouring points are too close for the length of the path; remove one of them or split the path"
    )]
    TooClose,
    /// The curve turns too sharply for an arc-length parametrisation within tolerance.
    #[error(
        "the path turns too sharply between its points, most sharply near point {point} at ({x:.6}, {y:.6}) (|p'(s)| deviates \
         from 1 by {error:.1e} with {pieces} spline pieces); add points or smooth them"
    )]
    TooSharp {
        /// Index of the point before the sharpest turn.
        point: usize,
        /// The x coordinate of this point, m.
        x: f64,
        /// The y coordinate of this point, m.
        y: f64,
        /// Largest deviation of `|p'(s)|` from 1.
        error: f64,
        /// Largest number of spline pieces tried.
        pieces: usize,
    },
    /// The path is longer than the spline resolves its bends.
    #[error(
        "the path is {length:.0} m long, and bends are resolved on at most {longest:.0} m; split it into parts"
    )]
    TooLong {
        /// Length of the path, m.
        length: f64,
        /// Largest length with the pieces that bends need, m.
        longest: f64,
    },
    /// The number of widths differs from the number of waypoints.
    #[error("expected {expected} rows of widths [left, right], one per point, got {got}")]
    WidthCount {
        /// Number of waypoints.
        expected: usize,
        /// Number of rows given.
        got: usize,
    },
    /// Zones that do not cover the path in increasing order.
    #[error(
        "zone {index} starts at {start}; starts must be fractions of the path's length that increase from 0 to below 1"
    )]
    ZoneStart {
        /// Index of the zone.
        index: usize,
        /// Its start.
        start: f64,
    },
    /// A zone with a surface that is out of range.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// Another number of places than the planner has.
    #[error("expected the friction at {expected} places, got {got}")]
    Places {
        /// Number of places.
        expected: usize,
        /// Number of values given.
        got: usize,
    },
    /// A parameter outside its range.
    #[error(transparent)]
    Parameter(#[from] OutOfRange),
    /// A speed profile of a path with another curve.
    #[error("the profile belongs to another path")]
    ForeignProfile,
    /// A built-in track with contradictory dimensions.
    #[error("{0}")]
    Track(String),
    /// A file that does not have its format.
    #[error("line {line}: {problem}")]
    Format {
        /// Line number, from 1.
        line: usize,
        /// Description of the problem.
        problem: String,
    },
    /// Headings that agree with neither convention.
    #[error(
        "psi_rad agrees with the direction of travel neither if measured from +x (mean error {from_x:.2} rad) \
         nor if measured from +y ({from_y:.2} rad); check the sign, the unit and the order of the points"
    )]
    Heading {
        /// Mean absolute error when psi is measured from +x.
        from_x: f64,
        /// Mean absolute error when psi is measured from +y.
        from_y: f64,
    },
}
