//! Speed profiles of paths.

use crate::error::{PathError, check};
use crate::knot::{Knot, Neighbour};
use crate::limits::{SPEED, SPEEDS, SpeedLimits};
use crate::path::Path;

/// Speed over the arc length of one path. The acceleration is constant between knots, so that time along the path has a
/// closed form.
#[derive(Debug, Clone)]
pub struct SpeedProfile {
    /// The identity of the path's curve.
    curve: u64,
    /// Whether the profile repeats, as that of a whole closed path does.
    closed: bool,
    /// Arc length in m of the first knot.
    start: f64,
    /// Length in m of a lap, if the profile is that of a part of a closed path.
    lap: Option<f64>,
    step: f64,
    /// `v²` at each knot, the end included.
    squares: Vec<f64>,
    /// Time in s since the start at each knot.
    times: Vec<f64>,
}

impl SpeedProfile {
    /// The fastest profile within the limits, by a backward pass for braking and a forward pass for driving. At every
    /// knot it satisfies the friction ellipse `(a_lat / (lateral mu g))² + (a_lon / (braking | driving) mu g)² <=
    /// grip²`, for the accelerations before and after the knot, with the lowest friction within a step. Where the tyres of
    /// the surface transmit less, `grip lateral mu g` is the share of their peak that [`SpeedLimits`] leaves.
    ///
    /// # Errors
    /// [`PathError`] if a limit is out of range or a closed path has a start or end speed.
    pub fn new(path: &Path, limits: &SpeedLimits) -> Result<Self, PathError> {
        limits.check(path.closed())?;
        let knots = Knot::along(path, limits);
        let mut squares: Vec<f64> = knots.iter().map(|knot| knot.cornering(limits)).collect();
        let count = knots.len();
        // The other knots lower the square of the speed of a lap's slowest knot by less than 0.1 %, so passes that start there
        // give a profile that is periodic to this accuracy.
        let mut first = 0;
        if path.closed() {
            first = (1..count).fold(0, |slowest, i| {
                if squares[i] < squares[slowest] {
                    i
                } else {
                    slowest
                }
            });
        } else {
            for (end, speed) in [(0, limits.start_speed), (count - 1, limits.end_speed)] {
                squares[end] = speed.map_or(squares[end], |v| squares[end].min(v * v));
            }
        }
        let pairs = (0..path.piece_count()).map(|k| ((first + k) % count, (first + k + 1) % count));
        let at = |knot: usize, squares: &[f64]| Neighbour {
            knot: &knots[knot],
            square: squares[knot],
            distance: path.step(),
        };
        for (knot, next) in pairs.clone().rev() {
            squares[knot] = knots[knot].before(&at(next, &squares), limits, squares[knot]);
        }
        for (knot, next) in pairs {
            squares[next] = knots[next].after(&at(knot, &squares), limits, squares[next]);
        }
        if path.closed() {
            squares.push(squares[0]);
        }
        Ok(Self::from_squares(path, squares))
    }

    /// A constant speed, independent of the friction.
    ///
    /// # Errors
    /// [`PathError`] if the speed is not from 0.001 to 10000 m/s.
    pub fn constant(path: &Path, speed: f64) -> Result<Self, PathError> {
        check("speed", speed, SPEED, |v| SPEEDS.contains(&v))?;
        Ok(Self::from_squares(
            path,
            vec![speed * speed; path.piece_count() + 1],
        ))
    }

    fn from_squares(path: &Path, squares: Vec<f64>) -> Self {
        let mut profile = Self {
            curve: path.curve(),
            closed: path.closed(),
            start: 0.0,
            lap: None,
            step: path.step(),
            times: vec![0.0; squares.len()],
            squares,
        };
        profile.integrate();
        profile
    }

    /// A profile of part of a path, for `knots` knots `step` m apart, to be filled by a planner.
    pub(crate) fn part_of(path: &Path, step: f64, knots: usize) -> Self {
        Self {
            curve: path.curve(),
            closed: false,
            start: 0.0,
            lap: path.closed().then(|| path.length()),
            step,
            squares: vec![0.0; knots],
            times: vec![0.0; knots],
        }
    }

    /// Lets the profile begin at `start`, writes `v²` at its knots with `fill`, and computes the times.
    pub(crate) fn refill(&mut self, start: f64, fill: impl FnOnce(&mut [f64])) {
        self.start = start;
        fill(&mut self.squares);
        self.integrate();
    }

    fn integrate(&mut self) {
        for (i, pair) in self.squares.windows(2).enumerate() {
            let speeds = pair[0].sqrt() + pair[1].sqrt();
            self.times[i + 1] = self.times[i] + 2.0 * self.step / speeds;
        }
    }

    /// [`Path::curve`] of the path that the profile belongs to.
    pub(crate) fn curve(&self) -> u64 {
        self.curve
    }

    /// Arc length in m at which the profile starts: 0, unless it is a plan of a [`crate::SpeedPlanner`].
    pub fn start(&self) -> f64 {
        self.start
    }

    /// Smallest and largest speed in m/s at the profile's knots, between which the speed is at all other places.
    pub fn speed_range(&self) -> (f64, f64) {
        let (least, most) = (self.squares.iter())
            .fold((f64::INFINITY, 0.0_f64), |(a, b), v| (a.min(*v), b.max(*v)));
        (least.sqrt(), most.sqrt())
    }

    /// `s` plus the whole laps that put it inside the profile or nearest to it. A profile longer than half a lap counts as
    /// half a lap long here, because the vehicle is near its start.
    pub(crate) fn unwrapped(&self, s: f64) -> f64 {
        let Some(lap) = self.lap else {
            return s;
        };
        let mut laps = ((self.start - s) / lap).ceil();
        let after = s + laps * lap - self.start;
        if after - self.length().min(0.5 * lap) > lap - after {
            laps -= 1.0;
        }
        s + laps * lap
    }

    /// Length in m of the profile.
    pub fn length(&self) -> f64 {
        self.step * (self.squares.len() - 1) as f64
    }

    /// Time in s of a lap, or from the profile's start to its end; infinite for a plan that stops before its end.
    pub fn lap_time(&self) -> f64 {
        self.times[self.times.len() - 1]
    }

    /// Speed in m/s at arc length `s`; constant beyond the profile's ends, unless it is that of a lap. On a closed path `s`
    /// may be that of any lap, also if the profile is a part of a lap. The result has no meaning unless `s` is finite.
    pub fn speed(&self, s: f64) -> f64 {
        self.speed_after(self.unwrapped(s) - self.start)
    }

    /// As [`Self::speed`], at an arc length that counts on from the profile's start, as those of [`Self::station`] do.
    pub(crate) fn speed_at(&self, s: f64) -> f64 {
        self.speed_after(s - self.start)
    }

    /// Speed at a distance from the first knot.
    fn speed_after(&self, s: f64) -> f64 {
        let s = if self.closed {
            s.rem_euclid(self.length())
        } else {
            s.clamp(0.0, self.length())
        };
        let (i, u) = self.locate(s);
        (self.squares[i] + 2.0 * self.acceleration(i) * u)
            .max(0.0)
            .sqrt()
    }

    /// Time in s at which the profile passes `s`, with time 0 at its start. Time continues to increase over the laps of
    /// a closed path. It is infinite beyond the place where a profile of an open path stops, and minus infinity before a
    /// start at speed zero. The result has no meaning unless `s` is finite.
    pub fn time(&self, s: f64) -> f64 {
        let (laps, s) = self.split(s - self.start, self.length());
        let inside = s.clamp(0.0, self.length());
        let (i, u) = self.locate(inside);
        let mut time = self.times[i];
        if self.closed {
            time += laps * self.lap_time();
        }
        if u > 0.0 {
            time += 2.0 * u / (self.squares[i].sqrt() + self.speed_after(inside));
        }
        if s == inside {
            time
        } else {
            time + (s - inside) / self.speed_after(inside)
        }
    }

    /// Arc length in m passed at `time` in s; the inverse of [`Self::time`]. Where a profile stops, it remains the same from
    /// then on. The result has no meaning unless `time` is finite.
    pub fn station(&self, time: f64) -> f64 {
        let (laps, time) = self.split(time, self.lap_time());
        let inside = time.clamp(0.0, self.lap_time());
        let i = self
            .times
            .partition_point(|&t| t <= inside)
            .clamp(1, self.times.len() - 1)
            - 1;
        let tau = inside - self.times[i];
        let u = tau * (self.squares[i].sqrt() + 0.5 * self.acceleration(i) * tau);
        let s = i as f64 * self.step + u.clamp(0.0, self.step);
        let beyond = if time == inside {
            0.0
        } else {
            (time - inside) * self.speed_after(s)
        };
        self.start + laps * self.length() + s + beyond
    }

    /// Number of whole laps of a closed path, and the remainder; on an open path no laps and `value`.
    fn split(&self, value: f64, lap: f64) -> (f64, f64) {
        if !self.closed {
            return (0.0, value);
        }
        let laps = (value / lap).floor();
        (laps, value - laps * lap)
    }

    fn locate(&self, s: f64) -> (usize, f64) {
        let i = ((s / self.step) as usize).min(self.squares.len() - 2);
        (i, s - i as f64 * self.step)
    }

    /// Acceleration in m/s² between a knot and the next.
    fn acceleration(&self, i: usize) -> f64 {
        (self.squares[i + 1] - self.squares[i]) / (2.0 * self.step)
    }
}
