//! Splines through waypoints, parametrised by their arc length.

use crate::error::{PathError, check};
use crate::spline::{Jet, Piece, interpolate};

/// Largest accepted deviation of `|p'(s)|` from 1.
const TOLERANCE: f64 = 1e-6;
/// Longest piece in m. It is short because the knots are the nodes of speed profiles, which must resolve corners.
const LONGEST_STEP: f64 = 0.5;
const MAX_PIECES: usize = 1 << 17;
/// Length of a piece in m below which it is not halved. A profile of the speed has a knot at each end of a piece.
const SHORTEST_STEP: f64 = 1e-3;
/// Smallest length of a path, m.
const LEAST_LENGTH: f64 = 0.1;
/// Number of parts of a piece for numerical integration.
const PARTS: u32 = 4;

/// A curve with knots at equal steps of its arc length.
pub(crate) struct ArcLengthSpline {
    pub pieces: Vec<Piece>,
    pub step: f64,
    /// Arc length at each waypoint.
    pub stations: Vec<f64>,
}

/// Interpolates the waypoints over their chord lengths, samples this curve at equal arc lengths and interpolates the
/// samples. The number of pieces is doubled until `|p'(s)| = 1` within [`TOLERANCE`].
pub(crate) fn parametrise(points: &[[f64; 2]], closed: bool) -> Result<ArcLengthSpline, PathError> {
    let chords = Chords::new(points, closed);
    let length = chords.length();
    if !length.is_finite() {
        // Where a chord is so short relative to the sum of the chords before it that two knots coincide, the spline is not
        // finite.
        return Err(PathError::TooClose);
    }
    check("the path's length", length, "at least 0.1 m", |length| {
        length >= LEAST_LENGTH
    })?;
    let mut count = (length / LONGEST_STEP)
        .ceil()
        .clamp(16.0, MAX_PIECES as f64) as usize;
    loop {
        let step = length / count as f64;
        let knots: Vec<f64> = (0..=count).map(|i| i as f64 * step).collect();
        let sampled = chords.sample(&knots[..count + usize::from(!closed)]);
        let pieces = interpolate(&knots, &sampled, closed);
        let (sharpest, error) = pieces
            .iter()
            .map(|piece| piece_error(piece, step))
            .enumerate()
            .fold(
                (0, 0.0),
                |most, found| if found.1 > most.1 { found } else { most },
            );
        if error <= TOLERANCE {
            let mut stations = chords.stations;
            stations.truncate(points.len());
            return Ok(ArcLengthSpline {
                pieces,
                step,
                stations,
            });
        }
        if count >= MAX_PIECES || step < SHORTEST_STEP {
            let longest = MAX_PIECES as f64 * LONGEST_STEP;
            if length > longest {
                return Err(PathError::TooLong { length, longest });
            }
            let at = sharpest as f64 * step;
            let point = chords.stations[..points.len()]
                .partition_point(|s| *s <= at)
                .saturating_sub(1);
            let [x, y] = points[point];
            return Err(PathError::TooSharp {
                point,
                x,
                y,
                error,
                pieces: count,
            });
        }
        count *= 2;
    }
}

/// Largest deviation of `|p'(s)|` from 1 on a piece. At a cusp that is a sample, the samples and so the spline are no numbers.
fn piece_error(piece: &Piece, step: f64) -> f64 {
    let errors = [0.0, 0.25, 0.5, 0.75, 1.0].map(|at| (piece.jet(at * step).speed() - 1.0).abs());
    if errors.iter().any(|error| error.is_nan()) {
        f64::INFINITY
    } else {
        errors.into_iter().fold(0.0, f64::max)
    }
}

/// The spline over chord lengths, with the arc length at its knots.
struct Chords {
    knots: Vec<f64>,
    pieces: Vec<Piece>,
    stations: Vec<f64>,
}

impl Chords {
    fn new(points: &[[f64; 2]], closed: bool) -> Self {
        let ends = points
            .iter()
            .skip(1)
            .chain(points.first().filter(|_| closed));
        let knots = cumulative(
            points
                .iter()
                .zip(ends)
                .map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])),
        );
        let pieces = interpolate(&knots, points, closed);
        let stations = cumulative(
            pieces
                .iter()
                .zip(knots.windows(2))
                .map(|(piece, k)| arc(piece, k[1] - k[0])),
        );
        Self {
            knots,
            pieces,
            stations,
        }
    }

    fn length(&self) -> f64 {
        self.stations.last().copied().unwrap_or_default()
    }

    /// Points at increasing arc lengths, by Newton's method on the arc length of each piece.
    fn sample(&self, arc_lengths: &[f64]) -> Vec<[f64; 2]> {
        let mut i = 0;
        (arc_lengths.iter())
            .map(|&s| {
                while i + 1 < self.pieces.len() && self.stations[i + 1] <= s {
                    i += 1;
                }
                let (piece, target) = (&self.pieces[i], s - self.stations[i]);
                let span = self.knots[i + 1] - self.knots[i];
                let mut u = span * target / (self.stations[i + 1] - self.stations[i]);
                for _ in 0..8 {
                    let correction = (arc(piece, u) - target) / piece.jet(u).speed();
                    u = (u - correction).clamp(0.0, span);
                    if correction.abs() <= 1e-14 * span {
                        break;
                    }
                }
                let Jet { position, .. } = piece.jet(u);
                position
            })
            .collect()
    }
}

/// Cumulative sums, starting with 0.
fn cumulative(lengths: impl Iterator<Item = f64>) -> Vec<f64> {
    let sums = lengths.scan(0.0, |sum, length| {
        *sum += length;
        Some(*sum)
    });
    std::iter::once(0.0).chain(sums).collect()
}

/// Arc length of a piece up to `u`, by Gauss-Legendre quadrature with five points on each part.
fn arc(piece: &Piece, u: f64) -> f64 {
    const NODES: [(f64, f64); 5] = [
        (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
        (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (0.0, 0.568_888_888_888_888_9),
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
        (0.906_179_845_938_664, 0.236_926_885_056_189_1),
    ];
    let half = u / f64::from(2 * PARTS);
    (0..PARTS)
        .flat_map(|part| NODES.map(|(at, weight)| (f64::from(2 * part + 1) + at, weight)))
        .map(|(at, weight)| weight * half * piece.jet(half * at).speed())
        .sum()
}
