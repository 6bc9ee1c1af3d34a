//! Speed profiles of paths.

use egp_parameters::STANDARD_GRAVITY;

use crate::error::{PathError, check};
use crate::limits::SpeedLimits;
use crate::path::Path;

/// Speed over the arc length of one path. The acceleration is constant between knots, so that time along the path has a
/// closed form.
#[derive(Debug, Clone)]
pub struct SpeedProfile {
    closed: bool,
    step: f64,
    /// `v²` at each knot, the end included.
    squares: Vec<f64>,
    /// Time in s since the start at each knot.
    times: Vec<f64>,
}

impl SpeedProfile {
    /// The fastest profile within the limits, by a backward pass for braking and a forward pass for driving. At every
    /// knot it satisfies the friction ellipse `(a_lat / (lateral mu g))² + (a_lon / (braking | driving) mu g)² <=
    /// grip²`, for the accelerations before and after the knot, with the lowest friction within a step.
    ///
    /// # Errors
    /// [`PathError`] if a limit is out of range or a closed path has a start or end speed.
    pub fn new(path: &Path, limits: &SpeedLimits) -> Result<Self, PathError> {
        limits.check(path.closed())?;
        let knots = Knot::along(path, limits);
        let top = limits.v_max * limits.v_max;
        let mut squares: Vec<f64> = knots
            .iter()
            .map(|knot| top.min(knot.lateral / knot.curvature))
            .collect();
        let count = knots.len();
        // No other knot lowers the speed of a lap's slowest knot, so passes that start there give a periodic profile.
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
        let mut limit = |from: usize, to: usize, allowed: &dyn Fn(&Knot, f64) -> f64| {
            squares[to] = reach(
                (&knots[from], squares[from]),
                (&knots[to], squares[to]),
                path.step(),
                allowed,
            );
        };
        for (knot, next) in pairs.clone().rev() {
            limit(next, knot, &|at, square| at.braking(limits, square));
        }
        for (knot, next) in pairs {
            limit(knot, next, &|at, square| at.driving(limits, square));
        }
        if path.closed() {
            squares.push(squares[0]);
        }
        Ok(Self::from_squares(path, squares))
    }

    /// A constant speed, independent of the friction.
    ///
    /// # Errors
    /// [`PathError`] if the speed is not positive.
    pub fn constant(path: &Path, speed: f64) -> Result<Self, PathError> {
        check("speed", speed, "a positive number", |v| v > 0.0)?;
        Ok(Self::from_squares(
            path,
            vec![speed * speed; path.piece_count() + 1],
        ))
    }

    fn from_squares(path: &Path, squares: Vec<f64>) -> Self {
        let step = path.step();
        let mut times = vec![0.0; squares.len()];
        for i in 1..times.len() {
            times[i] = times[i - 1] + 2.0 * step / (squares[i - 1].sqrt() + squares[i].sqrt());
        }
        Self {
            closed: path.closed(),
            step,
            squares,
            times,
        }
    }

    /// Length in m of the profile's path.
    pub fn length(&self) -> f64 {
        self.step * (self.squares.len() - 1) as f64
    }

    /// Time in s of a lap, or from start to end of an open path.
    pub fn lap_time(&self) -> f64 {
        self.times[self.times.len() - 1]
    }

    /// Speed in m/s at arc length `s`; constant beyond the ends of an open path.
    pub fn speed(&self, s: f64) -> f64 {
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

    /// Time in s at which the profile passes `s`, with `s = 0` at time 0. Time continues to increase over the laps of a
    /// closed path.
    pub fn time(&self, s: f64) -> f64 {
        let (laps, s) = self.split(s, self.length());
        let inside = s.clamp(0.0, self.length());
        let (i, u) = self.locate(inside);
        let mut time = laps * self.lap_time() + self.times[i];
        if u > 0.0 {
            time += 2.0 * u / (self.squares[i].sqrt() + self.speed(inside));
        }
        if s == inside {
            time
        } else {
            time + (s - inside) / self.speed(inside)
        }
    }

    /// Arc length passed at `time`; the inverse of [`Self::time`].
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
            (time - inside) * self.speed(s)
        };
        laps * self.length() + s + beyond
    }

    /// Number of whole laps of a closed path, and the remainder.
    fn split(&self, value: f64, lap: f64) -> (f64, f64) {
        let laps = if self.closed {
            (value / lap).floor()
        } else {
            0.0
        };
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

/// Bounds of the speed at one knot.
struct Knot {
    /// Absolute curvature in 1/m.
    curvature: f64,
    /// Usable grip in m/s².
    grip: f64,
    /// Largest lateral acceleration in m/s².
    lateral: f64,
}

impl Knot {
    fn along(path: &Path, limits: &SpeedLimits) -> Vec<Self> {
        let step = path.step();
        (0..path.piece_count() + usize::from(!path.closed()))
            .map(|knot| {
                let s = knot as f64 * step;
                let friction = [s - step, s, s + step]
                    .map(|s| path.friction(s))
                    .into_iter()
                    .fold(f64::INFINITY, f64::min);
                let grip = limits.grip * friction * STANDARD_GRAVITY;
                Self {
                    curvature: path.sample(s).curvature.abs(),
                    grip,
                    lateral: limits.lateral * grip,
                }
            })
            .collect()
    }

    /// The share of the longitudinal grip that remains when cornering at `v²`, from the friction ellipse.
    fn longitudinal_share(&self, square: f64) -> f64 {
        let load = square * self.curvature / self.lateral;
        (1.0 - load * load).max(0.0).sqrt()
    }

    fn braking(&self, limits: &SpeedLimits, square: f64) -> f64 {
        (limits.braking * self.grip * self.longitudinal_share(square)).min(limits.a_brake)
    }

    fn driving(&self, limits: &SpeedLimits, square: f64) -> f64 {
        let motor = limits.a_drive.min(limits.power / square.sqrt());
        (limits.driving * self.grip * self.longitudinal_share(square)).min(motor)
    }
}

/// The largest `v²` at `to`, at most `limit`, that can be reached from `from` with the acceleration allowed at both
/// knots. The allowed acceleration decreases with speed, so bisection finds the bound.
fn reach(
    (from, start): (&Knot, f64),
    (to, limit): (&Knot, f64),
    step: f64,
    allowed: &dyn Fn(&Knot, f64) -> f64,
) -> f64 {
    let feasible = |square: f64| square - start <= 2.0 * step * allowed(to, square);
    let most = limit.min(start + 2.0 * step * allowed(from, start));
    if most <= start || feasible(most) {
        return most;
    }
    let (mut low, mut high) = (start, most);
    for _ in 0..50 {
        let middle = f64::midpoint(low, high);
        if feasible(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}
