//! Reference speed ahead of the vehicle, for estimated friction.

use crate::error::{PathError, check};
use crate::knot::{Knot, Neighbour};
use crate::limits::{SPEEDS, SpeedLimits};
use crate::path::Path;
use crate::speed::SpeedProfile;

/// Distance that is planned, as a multiple of the knots' largest spacing. The road beyond it bounds the speed at its end.
const DISTANCE: f64 = 250.0;
/// Largest distance between knots, m.
const SPACING: f64 = 1.0;
/// Largest distance between knots as a share of the path's smallest radius. Farther apart, the speed that is interpolated between
/// two knots of a tight bend would need more than its share of the grip.
const SHARE_OF_RADIUS: f64 = 0.125;
/// Smallest value of the largest distance, m, however tight the path is.
const NARROWEST: f64 = 0.05;
/// Distance behind the vehicle, in knots, at which a plan has the vehicle's present speed. With it the reference at the vehicle
/// is above the measured speed while it drives and below it while it brakes; a controller that weighs its inputs would
/// otherwise reach less than the planned acceleration, because the reference begins at the measured speed in each period.
const OFFSET: f64 = 0.5;

/// Plans the speed over the next 250 m of a path, or 31 times its smallest radius if that is less than 8 m, once in each control
/// period. Allocates nothing while planning.
#[derive(Debug, Clone)]
pub struct SpeedPlanner {
    limits: SpeedLimits,
    closed: bool,
    step: f64,
    /// Largest absolute curvature within half a step of each knot of the path, 1/m.
    curvature: Vec<f64>,
    knots: Vec<Knot>,
    profile: SpeedProfile,
}

impl SpeedPlanner {
    /// A planner for a path. The path's zones of friction are not used.
    ///
    /// # Errors
    /// [`PathError`] if a limit is out of range, there is a start speed, a closed path has an end speed, or the path is
    /// shorter than 1 m.
    pub fn new(path: &Path, limits: &SpeedLimits) -> Result<Self, PathError> {
        const BETWEEN: usize = 4;
        limits.check(path.closed())?;
        if let Some(value) = limits.start_speed {
            let expected = "no value (a plan begins at the vehicle)";
            check("start_speed", value, expected, |_| false)?;
        }
        check(
            "the path's length",
            path.length(),
            "at least 1 m",
            |length| length >= 1.0,
        )?;
        let spacing = (SHARE_OF_RADIUS / sharpest(path)).clamp(NARROWEST, SPACING);
        let pieces = (path.length() / spacing).ceil();
        let step = path.length() / pieces;
        let pieces = pieces as usize;
        let curvature = (0..pieces + usize::from(!path.closed()))
            .map(|knot| {
                let parts = (0..=BETWEEN).map(|i| i as f64 / BETWEEN as f64 - 0.5);
                parts.fold(0.0_f64, |most, part| {
                    let s = (knot as f64 + part) * step;
                    most.max(path.sample(s).curvature.abs())
                })
            })
            .collect();
        let knots = (DISTANCE * spacing / step).ceil() as usize + 1;
        Ok(Self {
            limits: limits.clone(),
            closed: path.closed(),
            step,
            curvature,
            knots: vec![Knot::default(); knots],
            profile: SpeedProfile::part_of(path, step, knots),
        })
    }

    /// The limits of the speed.
    pub fn limits(&self) -> &SpeedLimits {
        &self.limits
    }

    /// Whether the path is a lap.
    pub fn closed(&self) -> bool {
        self.closed
    }

    /// Distance in m between the places of [`Self::plan`].
    pub fn step(&self) -> f64 {
        self.step
    }

    /// Number of places of [`Self::plan`].
    pub fn places(&self) -> usize {
        self.knots.len()
    }

    /// Arc length of the first place for a vehicle at `s`: the last knot that it has passed.
    pub fn start(&self, s: f64) -> f64 {
        (s / self.step).floor() * self.step
    }

    /// Checks the arguments of [`Self::plan`].
    fn check_plan(&self, s: f64, v: Option<f64>, friction: &[f64]) -> Result<(), PathError> {
        check("s", s, "a finite arc length", |_| true)?;
        check(
            "v",
            v.unwrap_or_default(),
            "a speed within ±10000 m/s",
            |v| v.abs() <= *SPEEDS.end(),
        )?;
        if friction.len() != self.knots.len() {
            return Err(PathError::Places {
                expected: self.knots.len(),
                got: friction.len(),
            });
        }
        for mu in friction {
            check("friction", *mu, "a positive number", |mu| mu > 0.0)?;
        }
        Ok(())
    }

    /// The fastest speed from `s` on, by a backward pass for braking and a forward pass for driving from the present speed
    /// `v`, which the plan has half a step behind the vehicle. Where the vehicle is too fast for what lies ahead, the plan
    /// brakes with all grip. At the last place the vehicle can still brake for the bends beyond it, as far as it brakes from
    /// the highest speed on a straight, and for the end of an open path, on the friction of this place.
    ///
    /// `friction` has the friction coefficient to plan for at each place, [`Self::step`] m apart from [`Self::start`]
    /// on. Without a present speed the plan begins with the largest one.
    ///
    /// # Errors
    /// [`PathError`] unless `s` is finite, `v` is within ±10000 m/s, and `friction` has [`Self::places`] positive numbers.
    pub fn plan(
        &mut self,
        s: f64,
        v: Option<f64>,
        friction: &[f64],
    ) -> Result<&SpeedProfile, PathError> {
        self.check_plan(s, v, friction)?;
        let first = (s / self.step).floor();
        let Self {
            limits,
            closed,
            step,
            curvature,
            knots,
            profile,
        } = self;
        let road = Road {
            limits,
            closed: *closed,
            curvature: &*curvature,
            step: *step,
        };
        let at = road.curvatures(first);
        for (i, (knot, mu)) in knots.iter_mut().zip(friction).enumerate() {
            *knot = Knot::new(at(i), *mu, limits);
        }
        let end = limits.end_speed.map(|speed| {
            let end = curvature.len() as f64 - 1.0 - first;
            (end.max(0.0) as usize, speed * speed)
        });
        let last = first + (friction.len() - 1) as f64;
        let at_last = road.square(last, friction[friction.len() - 1]);
        profile.refill(first * *step, |squares| {
            for (square, knot) in squares.iter_mut().zip(&*knots) {
                *square = knot.cornering(limits);
            }
            if let Some((end, most)) = end {
                for square in squares.iter_mut().skip(end) {
                    *square = square.min(most);
                }
            }
            if let Some(last) = squares.last_mut() {
                *last = last.min(at_last);
            }
            let at = |knot: usize, squares: &[f64]| Neighbour {
                knot: &knots[knot],
                square: squares[knot],
                distance: *step,
            };
            for i in (1..squares.len()).rev() {
                squares[i - 1] = knots[i - 1].before(&at(i, squares), limits, squares[i - 1]);
            }
            let mut next = 1;
            if let Some(v) = v {
                let present = v.max(0.0).powi(2);
                let passed = (s / *step - first - OFFSET) * *step;
                let place = |distance: f64| Neighbour {
                    knot: &knots[0],
                    square: present,
                    distance,
                };
                if passed < 0.0 {
                    squares[0] =
                        knots[0].within_drive_and_brakes(&place(-passed), limits, squares[0]);
                } else {
                    let left = *step - passed;
                    squares[1] = knots[1].within_drive_and_brakes(&place(left), limits, squares[1]);
                    // The piece from the first knot continues the acceleration backwards.
                    squares[0] = (present - (squares[1] - present) * passed / left).max(0.0);
                    next = 2;
                }
            }
            for i in next..squares.len() {
                let previous = at(i - 1, squares);
                squares[i] = knots[i].within_drive_and_brakes(&previous, limits, squares[i]);
            }
        });
        Ok(&self.profile)
    }
}

/// The largest absolute curvature of a path, 1/m, at the ends and in the middle of its pieces.
fn sharpest(path: &Path) -> f64 {
    let half = 0.5 * path.step();
    (0..=2 * path.piece_count())
        .map(|i| path.sample(i as f64 * half).curvature.abs())
        .fold(0.0, f64::max)
}

/// The road at the places of a plan and beyond the last one.
struct Road<'a> {
    limits: &'a SpeedLimits,
    closed: bool,
    /// Largest absolute curvature at each knot of the path, 1/m.
    curvature: &'a [f64],
    step: f64,
}

impl Road<'_> {
    /// Largest absolute curvature at the knots from `first` on, 1/m; 0 beyond the ends of an open path.
    fn curvatures(&self, first: f64) -> impl Fn(usize) -> f64 {
        let knots = self.curvature.len();
        let on_lap = first.rem_euclid(knots as f64) as usize;
        move |ahead| {
            if self.closed {
                return self.curvature[(on_lap + ahead) % knots];
            }
            let index = first + ahead as f64;
            if index < 0.0 {
                0.0
            } else {
                self.curvature.get(index as usize).copied().unwrap_or(0.0)
            }
        }
    }

    /// The largest `v²` at the knot `last` that braking on friction `mu` allows for the bends beyond it and the end speed of
    /// an open path, by the backward pass of a plan over the braking distance of the highest speed.
    fn square(&self, last: f64, mu: f64) -> f64 {
        let straight = Knot::new(0.0, mu, self.limits);
        let gained = 2.0 * self.step * straight.deceleration(self.limits);
        let (fastest, knots) = (self.limits.v_max.powi(2), self.curvature.len() as f64);
        let end = knots - 1.0 - last;
        // No place of a closed path is more than a lap ahead, and none of an open one beyond its end.
        let longest = if self.closed { knots } else { end.max(0.0) };
        let ahead = (fastest / gained).ceil().min(longest) as usize;
        let curvature = self.curvatures(last);
        let knot = |ahead: usize| straight.in_bend(curvature(ahead));
        let mut next = knot(ahead);
        let mut square = next.cornering(self.limits);
        if let Some(speed) = self.limits.end_speed
            && ahead as f64 >= end
        {
            square = square.min(speed * speed);
        }
        for ahead in (0..ahead).rev() {
            let here = knot(ahead);
            let there = Neighbour {
                knot: &next,
                square,
                distance: self.step,
            };
            square = here.before(&there, self.limits, here.cornering(self.limits));
            next = here;
        }
        square
    }
}
