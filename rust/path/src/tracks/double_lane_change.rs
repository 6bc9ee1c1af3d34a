//! The severe double lane change of ISO 3888-2.

use super::{SPACING, check_length};
use crate::error::{PathError, check};
use crate::path::Path;

/// Obstacle avoidance as in ISO 3888-2: three lanes of cones, 12, 11 and 12 m long, with gaps of
/// 13.5 and 12.5 m; the second lane is displaced so far to the left that its right cones stand 1 m
/// beside the first one's left. The path through them is the one of least curvature that keeps the
/// vehicle inside: driven along the middle of the lanes, the course takes twice the lateral grip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubleLaneChange {
    /// Width of the vehicle in m without mirrors; the lanes are as wide as it demands.
    pub vehicle_width: f64,
    /// Distance in m that the path keeps between the vehicle's side and the cones.
    pub margin: f64,
    /// Straight before the first cones in m, as wide as the first lane.
    pub lead_in: f64,
    /// Straight after the last cones in m, as wide as the last lane.
    pub lead_out: f64,
}

/// One lane of cones; `y` is 0 in the middle of the first lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Section {
    /// Where it starts, in m from the first cones.
    pub start: f64,
    /// Where it ends, in m from the first cones.
    pub end: f64,
    /// y of its left cones.
    pub left: f64,
    /// y of its right cones.
    pub right: f64,
}

/// y of what bounds the road on both sides.
#[derive(Clone, Copy)]
struct Bounds {
    left: f64,
    right: f64,
}

impl DoubleLaneChange {
    /// For a vehicle of this width in m without mirrors.
    pub fn of(vehicle_width: f64) -> Self {
        Self {
            vehicle_width,
            margin: 0.1,
            lead_in: 40.0,
            lead_out: 40.0,
        }
    }

    /// The three lanes. Their widths follow the vehicle's width `b`: `1.1 b + 0.25`, `b + 1`,
    /// `1.3 b + 0.25` but at least 3 m; the right cones of the first and the last stand in line.
    pub fn sections(&self) -> [Section; 3] {
        let b = self.vehicle_width;
        let (first, second, third) = (1.1 * b + 0.25, b + 1.0, (1.3 * b + 0.25).max(3.0));
        let lane = |start, length, right: f64, width| Section {
            start,
            end: start + length,
            left: right + width,
            right,
        };
        [
            lane(0.0, 12.0, -first / 2.0, first),
            lane(25.5, 11.0, first / 2.0 + 1.0, second),
            lane(49.0, 12.0, -first / 2.0, third),
        ]
    }

    /// The path, from `lead_in` before the first cones. Its widths reach to the cones and, in the gaps,
    /// to the outermost of the two lanes.
    ///
    /// # Errors
    /// A dimension out of range, or a margin that leaves no room in the first lane.
    pub fn path(&self) -> Result<Path, PathError> {
        check(
            "vehicle_width",
            self.vehicle_width,
            "a width in [0.5, 4] m",
            |b| (0.5..=4.0).contains(&b),
        )?;
        check(
            "margin",
            self.margin,
            "less than 0.05 vehicle widths + 0.125 m",
            |m| m >= 0.0 && m < 0.05 * self.vehicle_width + 0.125,
        )?;
        check_length("lead_in", self.lead_in)?;
        check_length("lead_out", self.lead_out)?;
        let before = (self.lead_in / SPACING).ceil() as usize;
        let count = before + ((61.0 + self.lead_out) / SPACING).ceil() as usize + 1;
        let from_cones = |i: usize| (i as f64 - before as f64) * SPACING;
        let edges: Vec<_> = (0..count).map(|i| self.edges(from_cones(i))).collect();

        let room = self.vehicle_width / 2.0 + self.margin;
        let mut corridor: Vec<_> = (edges.iter())
            .map(|edge| Bounds {
                left: edge.left - room,
                right: edge.right + room,
            })
            .collect();
        // A clamped start leaves along +x; the end is only held in the middle, so its curvature fades.
        for i in [0, 1, 2, count - 1] {
            let middle = f64::midpoint(edges[i].left, edges[i].right);
            corridor[i] = Bounds {
                left: middle,
                right: middle,
            };
        }
        let lateral = least_curvature(&corridor);
        let points: Vec<_> = lateral
            .iter()
            .enumerate()
            .map(|(i, &y)| [i as f64 * SPACING, y])
            .collect();
        let widths: Vec<_> = edges
            .iter()
            .zip(&lateral)
            .map(|(edge, y)| [edge.left - y, y - edge.right])
            .collect();
        Path::from_points(&points, false, Some(&widths))
    }

    /// What bounds the road at a distance from the first cones.
    fn edges(&self, x: f64) -> Bounds {
        let [first, second, third] = self.sections();
        let of = |lane: Section| Bounds {
            left: lane.left,
            right: lane.right,
        };
        let hull = |lane: Section| Bounds {
            left: second.left,
            right: lane.right,
        };
        if x <= first.end {
            of(first)
        } else if x < second.start {
            hull(first)
        } else if x <= second.end {
            of(second)
        } else if x < third.start {
            hull(third)
        } else {
            of(third)
        }
    }
}

/// Lateral positions in steps of [`SPACING`] that minimise the sum of squared second differences
/// between soft walls: each wall that is crossed pulls back with a spring, and Newton's method solves
/// for the positions until the set of crossed walls stays. The springs grow stiff in stages, which
/// keeps those sets from alternating; at last they give way by a few micrometres.
fn least_curvature(corridor: &[Bounds]) -> Vec<f64> {
    let mut lateral: Vec<f64> = corridor
        .iter()
        .map(|b| f64::midpoint(b.left, b.right))
        .collect();
    let wall = |y: f64, b: &Bounds| {
        if y >= b.left {
            Some(b.left)
        } else if y <= b.right {
            Some(b.right)
        } else {
            None
        }
    };
    let mut walls: Vec<Option<f64>> = vec![None; corridor.len()];
    for stiffness in [1e-4, 1e-2, 1.0, 1e2] {
        for _ in 0..50 {
            let crossed: Vec<_> = lateral
                .iter()
                .zip(corridor)
                .map(|(&y, b)| wall(y, b))
                .collect();
            lateral = pulled_beam(&crossed, stiffness);
            if crossed == std::mem::replace(&mut walls, crossed.clone()) {
                break;
            }
        }
    }
    lateral
}

/// Minimises `sum (y[i-1] - 2 y[i] + y[i+1])² + stiffness sum (y[i] - wall[i])²`: five diagonals,
/// factorised as `L D Lᵀ`. Two walls at least must pull.
fn pulled_beam(walls: &[Option<f64>], stiffness: f64) -> Vec<f64> {
    let n = walls.len();
    let mut bands = vec![[0.0; 3]; n]; // entries (i, i), (i, i-1), (i, i-2)
    let mut y: Vec<f64> = walls
        .iter()
        .map(|wall| wall.map_or(0.0, |at| stiffness * at))
        .collect();
    for (band, wall) in bands.iter_mut().zip(walls) {
        band[0] = if wall.is_some() { stiffness } else { 0.0 };
    }
    for i in 2..n {
        for (row, weight) in [
            (i, [1.0, -2.0, 1.0]),
            (i - 1, [4.0, -2.0, 0.0]),
            (i - 2, [1.0, 0.0, 0.0]),
        ] {
            (0..3).for_each(|k| bands[row][k] += weight[k]);
        }
    }
    for i in 0..n {
        if i >= 2 {
            bands[i][2] /= bands[i - 2][0];
            bands[i][1] -= bands[i][2] * bands[i - 2][0] * bands[i - 1][1];
            bands[i][0] -= bands[i][2] * bands[i][2] * bands[i - 2][0];
            y[i] -= bands[i][2] * y[i - 2];
        }
        if i >= 1 {
            bands[i][1] /= bands[i - 1][0];
            bands[i][0] -= bands[i][1] * bands[i][1] * bands[i - 1][0];
            y[i] -= bands[i][1] * y[i - 1];
        }
    }
    for i in (0..n).rev() {
        y[i] /= bands[i][0];
        for k in 1..=2 {
            if i + k < n {
                y[i] -= bands[i + k][k] * y[i + k];
            }
        }
    }
    y
}
