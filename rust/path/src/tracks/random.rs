//! Random closed tracks.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::check_length;
use crate::error::{PathError, check};
use crate::path::Path;

/// Number of points at which a candidate is checked.
const CHECKED: usize = 720;
/// Lowest and highest harmonic; the first would only translate the track.
const HARMONICS: std::ops::RangeInclusive<u32> = 2..=7;

/// A random lap, determined by its seed. In polar coordinates its radius is `r(t) = 1 + c sum a_k cos(k t + phase_k)`,
/// scaled to the given length. It cannot cross itself because each direction occurs once. `c <= 1` is reduced until no
/// turn is tighter than `min_radius` (within 0.1 %) and no two stretches are closer than one and a half track widths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RandomTrack {
    /// Seed of the random numbers.
    pub seed: u64,
    /// Length of the lap in m.
    pub length: f64,
    /// Radius of the tightest turn in m.
    pub min_radius: f64,
    /// Width of the track in m.
    pub track_width: f64,
}

impl RandomTrack {
    /// A lap of 500 m for the seed.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            length: 500.0,
            min_radius: 15.0,
            track_width: 7.0,
        }
    }

    /// The path, counter-clockwise from its point of least curvature.
    ///
    /// # Errors
    /// [`PathError`] if a dimension is not positive, the lap is too short for its radius, or the radius is at most half
    /// the track's width.
    pub fn path(&self) -> Result<Path, PathError> {
        check_length("length", self.length)?;
        check_length("track_width", self.track_width)?;
        check(
            "min_radius",
            self.min_radius,
            "more than half the track's width",
            |r| r > self.track_width / 2.0,
        )?;
        if self.length < 1.5 * TAU * self.min_radius {
            return Err(PathError::Track(format!(
                "a lap of {} m is too short for turns of radius {} m, which need {:.0} m",
                self.length,
                self.min_radius,
                1.5 * TAU * self.min_radius
            )));
        }
        let mut shape = Shape::draw(self.seed);
        // This ends: with less and less contrast the shape becomes a circle, which is accepted. Its radius is at least 1.5
        // times `min_radius`, and points on it that are compared are at least two of the smallest distances apart.
        while !self.accepts(&shape) {
            shape.contrast *= 0.95;
        }
        let points = self.waypoints(&shape);
        let widths = vec![[self.track_width / 2.0; 2]; points.len()];
        Path::from_points(&points, true, Some(&widths))
    }

    /// Ratio of the lap's length to the shape's length.
    fn scale(&self, shape: &Shape) -> f64 {
        let length: f64 =
            angles(CHECKED).map(|t| shape.at(t).speed()).sum::<f64>() * TAU / CHECKED as f64;
        self.length / length
    }

    fn accepts(&self, shape: &Shape) -> bool {
        let scale = self.scale(shape);
        let polar: Vec<_> = angles(CHECKED).map(|t| shape.at(t)).collect();
        if polar
            .iter()
            .any(|at| at.radius < 0.1 || at.curvature().abs() * self.min_radius > scale)
        {
            return false;
        }
        let points: Vec<_> = angles(CHECKED)
            .zip(&polar)
            .map(|(t, at)| [scale * at.radius * t.cos(), scale * at.radius * t.sin()])
            .collect();
        let apart = 1.5 * self.track_width;
        // Points closer along the track than half a turn of the tightest radius are not compared.
        let neighbours =
            (TAU / 2.0 * self.min_radius.max(apart) / self.length * CHECKED as f64).ceil() as usize;
        (0..CHECKED).all(|i| {
            (i + neighbours..CHECKED)
                .take_while(|j| j + neighbours < i + CHECKED)
                .all(|j| (points[j][0] - points[i][0]).hypot(points[j][1] - points[i][1]) > apart)
        })
    }

    /// Points about a metre apart, transformed so that the path starts at its point of least curvature in the origin in
    /// the direction +x.
    fn waypoints(&self, shape: &Shape) -> Vec<[f64; 2]> {
        let scale = self.scale(shape);
        let count = self.length.ceil() as usize;
        let bend = |t: f64| shape.at(t).curvature().abs();
        let start = angles(count).fold(0.0, |best, t| if bend(t) < bend(best) { t } else { best });
        let Polar { radius, slope, .. } = shape.at(start);
        let heading = start + radius.atan2(slope);
        let origin = [radius * start.cos(), radius * start.sin()];
        let (sin, cos) = heading.sin_cos();
        angles(count)
            .map(|t| {
                let at = shape.at(start + t).radius;
                let [x, y] = [
                    at * (start + t).cos() - origin[0],
                    at * (start + t).sin() - origin[1],
                ];
                [scale * (x * cos + y * sin), scale * (y * cos - x * sin)]
            })
            .collect()
    }
}

/// Evenly spaced angles of a full turn.
fn angles(count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| TAU * i as f64 / count as f64)
}

/// The radius as a function of the angle.
struct Shape {
    contrast: f64,
    /// Harmonic, amplitude, phase.
    waves: Vec<(f64, f64, f64)>,
}

/// Radius and its derivatives with respect to the angle.
struct Polar {
    radius: f64,
    slope: f64,
    bend: f64,
}

impl Shape {
    fn draw(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let waves = HARMONICS
            .map(|k| {
                (
                    f64::from(k),
                    random.random::<f64>() / f64::from(k),
                    TAU * random.random::<f64>(),
                )
            })
            .collect();
        Self {
            contrast: 1.0,
            waves,
        }
    }

    fn at(&self, t: f64) -> Polar {
        let mut polar = Polar {
            radius: 1.0,
            slope: 0.0,
            bend: 0.0,
        };
        for &(k, amplitude, phase) in &self.waves {
            let (sin, cos) = (k * t + phase).sin_cos();
            polar.radius += self.contrast * amplitude * cos;
            polar.slope -= self.contrast * amplitude * k * sin;
            polar.bend -= self.contrast * amplitude * k * k * cos;
        }
        polar
    }
}

impl Polar {
    /// Arc length per angle.
    fn speed(&self) -> f64 {
        self.radius.hypot(self.slope)
    }

    /// `(r² + 2 r'² - r r'') / (r² + r'²)^(3/2)`.
    fn curvature(&self) -> f64 {
        let Self {
            radius: r,
            slope,
            bend,
        } = self;
        (r * r + 2.0 * slope * slope - r * bend) / self.speed().powi(3)
    }
}
