//! The point of a path nearest to a position.

use crate::path::{Path, Sample, cross};

/// A position relative to a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Arc length of the nearest point in m: in `[0, length)` on a closed path; below 0 or above the length on the
    /// straight extensions of an open path.
    pub s: f64,
    /// Signed distance from the path in m, positive to its left.
    pub lateral: f64,
    /// The path at `s`.
    pub sample: Sample,
}

impl Path {
    /// Projects a finite position `[x, y]` onto the path.
    ///
    /// Without a hint the result is the nearest point of the whole path. With a hint, such as the last `s`, the
    /// distance is minimised locally from there. This is faster and stays on the same branch where a path crosses or
    /// approaches itself, but a distant hint leads to a local minimum.
    pub fn project(&self, position: [f64; 2], hint: Option<f64>) -> Projection {
        let s = match hint {
            Some(s) => self.refine(position, self.descend(position, s)).s,
            None => self.search(position),
        };
        let s = self.wrap(self.extend(position, s));
        let jet = self.jet(s);
        let lateral = cross(jet.first, offset(jet.position, position)) / jet.speed();
        Projection {
            s,
            lateral,
            sample: self.sample(s),
        }
    }

    /// Number of knots, including the end of an open path.
    fn knot_count(&self) -> usize {
        self.piece_count() + usize::from(!self.closed())
    }

    fn knot_distance(&self, position: [f64; 2], knot: usize) -> f64 {
        let at = if knot < self.piece_count() {
            self.knot(knot)
        } else {
            self.jet(self.length()).position
        };
        norm(offset(at, position))
    }

    /// The locally nearest knot, by descent from the hint.
    fn descend(&self, position: [f64; 2], hint: f64) -> usize {
        let count = self.knot_count();
        let last = self.knot_count() - 1;
        let nearest = (self.wrap(hint).clamp(0.0, self.length()) / self.step()).round() as usize;
        let mut knot = if self.closed() {
            nearest % count
        } else {
            nearest.min(last)
        };
        let mut best = self.knot_distance(position, knot);
        let ahead = |k: usize| {
            if self.closed() {
                (k + 1) % count
            } else {
                (k + 1).min(last)
            }
        };
        let behind = |k: usize| {
            if self.closed() {
                (k + last) % count
            } else {
                k.saturating_sub(1)
            }
        };
        let directions: [&dyn Fn(usize) -> usize; 2] = [&ahead, &behind];
        for next in directions {
            for _ in 0..count {
                let candidate = self.knot_distance(position, next(knot));
                if candidate >= best {
                    break;
                }
                (knot, best) = (next(knot), candidate);
            }
        }
        knot
    }

    /// Arc length of the globally nearest point. Every point of the curve is at most half a step from a knot, so only
    /// knots at most one step farther than the nearest knot can be next to this point.
    fn search(&self, position: [f64; 2]) -> f64 {
        let count = self.knot_count();
        let nearest = (0..count)
            .map(|knot| self.knot_distance(position, knot))
            .fold(f64::INFINITY, f64::min);
        (0..count)
            .filter(|&knot| self.knot_distance(position, knot) <= nearest + self.step())
            .map(|knot| self.refine(position, knot))
            .fold(
                Stationary {
                    s: 0.0,
                    distance: f64::INFINITY,
                },
                |best, found| {
                    if found.distance < best.distance {
                        found
                    } else {
                        best
                    }
                },
            )
            .s
    }

    /// The nearest point within one step of a knot: a root of `(p - q) . p'`, by bracketed Newton iteration.
    fn refine(&self, position: [f64; 2], knot: usize) -> Stationary {
        let at = knot as f64 * self.step();
        let (mut low, mut high) = (at - self.step(), at + self.step());
        if !self.closed() {
            (low, high) = (low.max(0.0), high.min(self.length()));
        }
        let mut s = at;
        for _ in 0..60 {
            let jet = self.jet(s);
            let gap = offset(position, jet.position);
            let slope = dot(gap, jet.first);
            if slope > 0.0 {
                high = s;
            } else {
                low = s;
            }
            let newton = s - slope / (dot(jet.first, jet.first) + dot(gap, jet.second));
            let next = if newton >= low && newton <= high {
                newton
            } else {
                f64::midpoint(low, high)
            };
            if (next - s).abs() <= 1e-13 * (1.0 + s.abs()) {
                break;
            }
            s = next;
        }
        Stationary {
            s,
            distance: norm(offset(self.jet(s).position, position)),
        }
    }

    /// Beyond an end of an open path, the foot of the perpendicular on its straight extension.
    fn extend(&self, position: [f64; 2], s: f64) -> f64 {
        let along = |end: f64| {
            let jet = self.jet(end);
            dot(offset(jet.position, position), jet.first) / jet.speed().powi(2)
        };
        let nearly = 1e-9 * self.length();
        if self.closed() {
            s
        } else if s <= nearly {
            s + along(0.0).min(0.0)
        } else if s >= self.length() - nearly {
            s + along(self.length()).max(0.0)
        } else {
            s
        }
    }
}

/// A place of the path where the distance in m to a position has a local minimum.
struct Stationary {
    s: f64,
    distance: f64,
}

/// The vector from `a` to `b`.
fn offset(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [b[0] - a[0], b[1] - a[1]]
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn norm(a: [f64; 2]) -> f64 {
    a[0].hypot(a[1])
}
