//! The reference path: a curve by arc length, with widths and friction.

use std::cell::Cell;
use std::f64::consts::TAU;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};

use egp_parameters::Surface;

use crate::arc_length::{ArcLengthSpline, parametrise};
use crate::error::PathError;
use crate::friction::{Zone, check_zones, sides_at};
use crate::parts::PathParts;
use crate::spline::{Jet, Piece};

/// Distance in m below which two points are the same.
const SAME_POINT: f64 = 1e-6;
/// Largest coordinate in m, beyond any map's. Lengths computed from larger ones overflow.
const FARTHEST: f64 = 1e8;

/// A planar curve `p(s)` with `|p'(s)| = 1` (to 1e-6) and continuous curvature.
#[derive(Debug, Clone)]
pub struct Path {
    closed: bool,
    step: f64,
    pieces: Vec<Piece>,
    /// `[left, right]` at each knot.
    widths: Option<Vec<[f64; 2]>>,
    zones: Vec<Zone>,
    /// [`Self::curve`].
    curve: u64,
}

/// Properties of a path at one arc length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Position in m.
    pub x: f64,
    /// Position in m.
    pub y: f64,
    /// Direction of travel in rad, in `[-pi, pi]`.
    pub yaw: f64,
    /// Curvature in 1/m, positive in left turns.
    pub curvature: f64,
    /// Distance to the left edge in m; infinite for a path without widths.
    pub left: f64,
    /// Distance to the right edge in m; infinite for a path without widths.
    pub right: f64,
    /// Friction coefficient; see [`Path::friction`].
    pub friction: f64,
}

impl Path {
    /// A path through waypoints in m, with `[left, right]` distances to the edges at each of them.
    ///
    /// Widths are interpolated linearly. A closed path may repeat its first point at the end.
    ///
    /// # Errors
    /// [`PathError`] if there are fewer than four points, points are repeated, not finite, beyond 1e8 m or turn too
    /// sharply, or widths are negative or not one row per point.
    pub fn from_points(
        points: &[[f64; 2]],
        closed: bool,
        widths: Option<&[[f64; 2]]>,
    ) -> Result<Self, PathError> {
        let wide = widths.unwrap_or_default();
        if widths.is_some() && wide.len() != points.len() {
            return Err(PathError::WidthCount {
                expected: points.len(),
                got: wide.len(),
            });
        }
        check_finite("coordinates within ±1e8 m", points, |p| {
            p.abs() <= FARTHEST
        })?;
        check_finite("widths of at least 0", wide, |w| w >= 0.0)?;
        let points = match points {
            [first, inner @ .., last] if closed && distance(*first, *last) < SAME_POINT => {
                &points[..=inner.len()]
            }
            _ => points,
        };
        if points.len() < 4 {
            return Err(PathError::TooFewPoints(points.len()));
        }
        if let Some(i) = points
            .windows(2)
            .position(|p| distance(p[0], p[1]) < SAME_POINT)
        {
            return Err(PathError::RepeatedPoint(i));
        }
        if let [first, .., last] = points
            && closed
            && distance(*first, *last) < SAME_POINT
        {
            return Err(PathError::RepeatedPoint(points.len() - 1));
        }
        let ArcLengthSpline {
            pieces,
            step,
            stations,
        } = parametrise(points, closed)?;
        let mut path = Self::of_pieces(closed, step, pieces);
        path.widths = widths.map(|widths| path.widths_at_knots(&stations, widths));
        Ok(path)
    }

    /// A path without widths and zones of friction.
    fn of_pieces(closed: bool, step: f64, pieces: Vec<Piece>) -> Self {
        Self {
            closed,
            step,
            curve: identity(closed, step, &pieces),
            pieces,
            widths: None,
            zones: Vec::new(),
        }
    }

    /// The numbers that the path consists of.
    pub fn parts(&self) -> PathParts {
        PathParts {
            closed: self.closed,
            step: self.step,
            pieces: self.pieces.iter().map(Piece::coefficients).collect(),
            widths: self.widths.clone(),
            zones: self.zones.clone(),
        }
    }

    /// The path that consists of the numbers that [`Self::parts`] gave. Whether the pieces join smoothly is not checked.
    ///
    /// # Errors
    /// [`PathError`] if there are no pieces, the step is not positive, a number is not finite or a width negative, widths are
    /// not one row per knot, or [`Self::with_friction`] would not accept the zones.
    pub fn from_parts(parts: PathParts) -> Result<Self, PathError> {
        parts.check()?;
        let pieces = parts.pieces.into_iter().map(Piece::new).collect();
        Ok(Self {
            widths: parts.widths,
            zones: parts.zones,
            ..Self::of_pieces(parts.closed, parts.step, pieces)
        })
    }

    /// The same path with these zones of friction, the first of which starts at 0.
    ///
    /// # Errors
    /// [`PathError`] if the starts do not increase from 0 to below 1 or a surface is out of range.
    pub fn with_friction(mut self, zones: &[Zone]) -> Result<Self, PathError> {
        check_zones(zones)?;
        self.zones = zones.to_vec();
        Ok(self)
    }

    /// Length in m; of one lap if closed.
    pub fn length(&self) -> f64 {
        self.step * self.pieces.len() as f64
    }

    /// Whether the end joins the start.
    pub fn closed(&self) -> bool {
        self.closed
    }

    /// A hash of the curve, which does not depend on widths and zones of friction. Paths with different curves have different
    /// hashes, but for a collision of 64 bits.
    pub(crate) fn curve(&self) -> u64 {
        self.curve
    }

    /// Whether the track's edges are known.
    pub fn has_widths(&self) -> bool {
        self.widths.is_some()
    }

    /// The path at arc length `s`. A closed path is periodic; an open path continues straight beyond its ends. The result
    /// has no meaning unless `s` is finite.
    pub fn sample(&self, s: f64) -> Sample {
        let Jet {
            position,
            first,
            second,
        } = self.jet(s);
        let [left, right] = self.widths_at(s);
        Sample {
            x: position[0],
            y: position[1],
            yaw: first[1].atan2(first[0]),
            curvature: cross(first, second) / first[0].hypot(first[1]).powi(3),
            left,
            right,
            friction: self.friction(s),
        }
    }

    /// Friction coefficient at arc length `s`; 1 on a path without zones.
    ///
    /// On a split road it is the mean of both sides, as for an axle with equal loads on both wheels.
    pub fn friction(&self, s: f64) -> f64 {
        let [left, right] = self.sides(s).map(|surface| surface.friction());
        f64::midpoint(left, right)
    }

    /// The surface at a position that projects to `s` with a signed distance from the path.
    pub fn surface_beside(&self, s: f64, lateral: f64) -> Surface {
        self.sides(s)[usize::from(lateral < 0.0)]
    }

    /// A function that gives the surface at a finite position `[x, y]`, m, by its projection. Its successive positions must be
    /// near each other, such as those of wheels: the arc length of each is the hint for the next one ([`Self::project`]), and
    /// `hint` is that for the first one.
    pub fn surfaces_near(&self, hint: Option<f64>) -> impl Fn([f64; 2]) -> Surface {
        let last = Cell::new(hint);
        move |position| {
            let projection = self.project(position, last.get());
            last.set(Some(projection.s));
            self.surface_beside(projection.s, projection.lateral)
        }
    }

    /// Surfaces `[left, right]` of the path.
    fn sides(&self, s: f64) -> [Surface; 2] {
        sides_at(&self.zones, self.wrap(s).max(0.0) / self.length())
    }

    /// `s` within `[0, length)` on a closed path, unchanged on an open one.
    pub fn wrap(&self, s: f64) -> f64 {
        if !self.closed {
            return s;
        }
        let wrapped = s.rem_euclid(self.length());
        if wrapped < self.length() {
            wrapped
        } else {
            0.0
        }
    }

    /// Distance between neighbouring knots in m.
    pub(crate) fn step(&self) -> f64 {
        self.step
    }

    /// Number of spline pieces.
    pub(crate) fn piece_count(&self) -> usize {
        self.pieces.len()
    }

    /// Position of a knot, `0..piece_count()`.
    pub(crate) fn knot(&self, index: usize) -> [f64; 2] {
        self.pieces[index].start()
    }

    /// Position and derivatives at any arc length.
    pub(crate) fn jet(&self, s: f64) -> Jet {
        let s = self.wrap(s);
        let inside = s.clamp(0.0, self.length());
        let (index, u) = self.locate(inside);
        let mut jet = self.pieces[index].jet(u);
        if s != inside {
            jet.position = [0, 1].map(|axis| jet.position[axis] + (s - inside) * jet.first[axis]);
            jet.second = [0.0; 2];
        }
        jet
    }

    /// The piece that holds `s` in `[0, length]`, and the distance from its start.
    fn locate(&self, s: f64) -> (usize, f64) {
        let index = ((s / self.step) as usize).min(self.pieces.len() - 1);
        (index, s - index as f64 * self.step)
    }

    fn widths_at(&self, s: f64) -> [f64; 2] {
        let Some(widths) = &self.widths else {
            return [f64::INFINITY; 2];
        };
        let (index, u) = self.locate(self.wrap(s).clamp(0.0, self.length()));
        let (a, b) = (widths[index], widths[(index + 1) % widths.len()]);
        // At the end of a piece whose width decreases to zero, rounding may leave less than zero.
        [0, 1].map(|side| (a[side] + (b[side] - a[side]) * u / self.step).max(0.0))
    }

    /// Linear interpolation of the waypoints' widths at the spline's knots.
    fn widths_at_knots(&self, stations: &[f64], widths: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let length = self.length();
        (0..self.pieces.len() + usize::from(!self.closed))
            .map(|knot| {
                let s = knot as f64 * self.step;
                let i = stations
                    .partition_point(|&station| station <= s)
                    .clamp(1, stations.len())
                    - 1;
                let end = stations.get(i + 1).copied().unwrap_or(length);
                // At the end of an open path this is 0 / 0; the width is then that of the last waypoint, because NaN is not
                // greater than zero.
                let ratio = ((s - stations[i]) / (end - stations[i])).clamp(0.0, 1.0);
                let next = if self.closed {
                    (i + 1) % stations.len()
                } else {
                    (i + 1).min(stations.len() - 1)
                };
                [0, 1].map(|side| {
                    let at = widths[i][side];
                    if ratio > 0.0 {
                        at + ratio * (widths[next][side] - at)
                    } else {
                        at
                    }
                })
            })
            .collect()
    }
}

/// [`Path::curve`] of a spline.
fn identity(closed: bool, step: f64, pieces: &[Piece]) -> u64 {
    let mut hasher = DefaultHasher::new(); // has no seed
    (closed, step.to_bits(), pieces.len()).hash(&mut hasher);
    for coefficient in pieces.iter().flat_map(Piece::coefficients).flatten() {
        coefficient.to_bits().hash(&mut hasher);
    }
    hasher.finish()
}

/// The angle in [-pi, pi] that differs from `angle` (rad) by whole turns.
pub(crate) fn wrap_angle(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

/// `a x b`, positive when `b` points to the left of `a`.
pub(crate) fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

/// Errors unless all values of the rows are finite and accepted.
pub(crate) fn check_finite<const N: usize>(
    what: &'static str,
    rows: &[[f64; N]],
    accept: impl Fn(f64) -> bool,
) -> Result<(), PathError> {
    match (rows.iter().enumerate())
        .flat_map(|(index, row)| row.map(|value| (index, value)))
        .find(|(_, value)| !value.is_finite() || !accept(*value))
    {
        Some((index, value)) => Err(PathError::NotFinite { what, index, value }),
        None => Ok(()),
    }
}
