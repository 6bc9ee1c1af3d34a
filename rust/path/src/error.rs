//! Why a path, a profile or a reference was refused.

use thiserror::Error;

/// A refused input; the message says what was expected, what came, and where.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PathError {
    /// Fewer waypoints than a spline needs.
    #[error("expected at least 4 distinct points, got {0}")]
    TooFewPoints(usize),
    /// A coordinate or width is not a number.
    #[error("expected finite {what}, got {value} at index {index}")]
    NotFinite {
        /// What the value is.
        what: &'static str,
        /// Where it stands in its list.
        index: usize,
        /// The value itself.
        value: f64,
    },
    /// Two neighbouring waypoints are the same point.
    #[error("points {0} and {next} are the same; remove one of them", next = .0 + 1)]
    RepeatedPoint(usize),
    /// The curve turns too sharply for an arc-length parametrisation within tolerance.
    #[error(
        "the path turns too sharply between its points (speed of the curve off by {error:.1e} with \
         {pieces} pieces); give more points or smooth them"
    )]
    TooSharp {
        /// Largest deviation of `|p'(s)|` from 1.
        error: f64,
        /// How many spline pieces were tried.
        pieces: usize,
    },
    /// One width per waypoint is needed.
    #[error("expected {expected} rows of widths [left, right], one per point, got {got}")]
    WidthCount {
        /// Number of waypoints.
        expected: usize,
        /// Number of rows given.
        got: usize,
    },
    /// Zones that don't say the friction everywhere.
    #[error(
        "zone {index} starts at {start}: starts are fractions of the path's length that rise from 0 to below 1"
    )]
    ZoneStart {
        /// Which zone.
        index: usize,
        /// Its start.
        start: f64,
    },
    /// A parameter outside its range.
    #[error("expected {expected} for {name}, got {value}")]
    Parameter {
        /// Its name.
        name: &'static str,
        /// What would be accepted.
        expected: &'static str,
        /// What came.
        value: f64,
    },
    /// A speed profile of another path.
    #[error("the speed profile belongs to a path of {profile} m, this one has {path} m")]
    ForeignProfile {
        /// Length the profile was made for.
        profile: f64,
        /// Length of the path in hand.
        path: f64,
    },
    /// Slices that differ in length.
    #[error(
        "expected as many rows of widths as of the reference ({reference}, at least 1), got {widths}"
    )]
    HorizonRows {
        /// Rows of the reference.
        reference: usize,
        /// Rows of the widths.
        widths: usize,
    },
    /// A built-in track whose dimensions contradict each other.
    #[error("{0}")]
    Track(String),
    /// A file that isn't what its format says.
    #[error("line {line}: {problem}")]
    Format {
        /// Line number, from 1.
        line: usize,
        /// What is wrong there.
        problem: String,
    },
    /// Headings that follow neither convention.
    #[error(
        "psi_rad fits the direction of travel neither measured from +x (mean error {from_x:.2} rad) \
         nor from +y ({from_y:.2} rad); check the sign, the unit and the order of the points"
    )]
    Heading {
        /// Mean absolute error when psi is measured from +x.
        from_x: f64,
        /// Mean absolute error when psi is measured from +y.
        from_y: f64,
    },
}

/// Refuses a parameter unless it is finite and `accept` holds.
pub(crate) fn check(
    name: &'static str,
    value: f64,
    expected: &'static str,
    accept: impl Fn(f64) -> bool,
) -> Result<(), PathError> {
    if value.is_finite() && accept(value) {
        Ok(())
    } else {
        Err(PathError::Parameter {
            name,
            expected,
            value,
        })
    }
}
