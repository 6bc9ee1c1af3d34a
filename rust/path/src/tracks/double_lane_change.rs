//! The severe double lane change of ISO 3888-2.

use super::{SPACING, check_length};
use crate::error::{PathError, check};
use crate::path::Path;

/// Obstacle avoidance of ISO 3888-2: three lanes of cones, 12, 11 and 12 m long, with gaps of 13.5 and 12.5 m. The
/// right cones of the second lane are 1 m to the left of the first lane's left cones. The path is the one of least
/// curvature that keeps the vehicle between the cones; along the middle of the lanes the course would need twice the
/// lateral grip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubleLaneChange {
    /// Width of the vehicle in m without mirrors, which determines the widths of the lanes.
    pub vehicle_width: f64,
    /// Smallest distance in m between the vehicle's side and the cones.
    pub margin: f64,
    /// Straight before the first cones in m, as wide as the first lane.
    pub lead_in: f64,
    /// Straight after the last cones in m, as wide as the last lane.
    pub lead_out: f64,
}

/// One lane of cones; `y` is 0 in the middle of the first lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Section {
    /// Start, in m from the first cones.
    pub start: f64,
    /// End, in m from the first cones.
    pub end: f64,
    /// y coordinate of the left cones, m.
    pub left: f64,
    /// y coordinate of the right cones, m.
    pub right: f64,
}

/// y coordinates of both edges of the road, m.
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
    /// `1.3 b + 0.25` but at least 3 m. The right cones of the first and the last lane are in line.
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

    /// The path, which starts `lead_in` before the first cones. Its widths extend to the cones and, in the gaps, to the
    /// outer edges of both lanes.
    ///
    /// # Errors
    /// [`PathError`] if a dimension is out of range or the margin leaves no room in the first lane.
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
            "0 to less than 0.05 vehicle widths + 0.125 m",
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
        // Three fixed points give the start the direction +x. The end has one fixed point, so its curvature tends to
        // zero.
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

    /// Edges of the road at the distance `x` from the first cones.
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

/// Lateral positions in steps of [`SPACING`] that minimise the sum of squared second differences subject to the
/// corridor, by a quadratic penalty method: violated bounds are penalised, and an active-set Newton method repeats
/// until the set of violated bounds no longer changes. The penalty weight increases in stages, which prevents cycling;
/// the remaining violation is a few micrometres.
fn least_curvature(corridor: &[Bounds]) -> Vec<f64> {
    let mut lateral: Vec<f64> = corridor
        .iter()
        .map(|b| f64::midpoint(b.left, b.right))
        .collect();
    let violated_bound = |y: f64, b: &Bounds| {
        if y >= b.left {
            Some(b.left)
        } else if y <= b.right {
            Some(b.right)
        } else {
            None
        }
    };
    let mut active: Vec<Option<f64>> = vec![None; corridor.len()];
    for weight in [1e-4, 1e-2, 1.0, 1e2] {
        for _ in 0..50 {
            let violated: Vec<_> = lateral
                .iter()
                .zip(corridor)
                .map(|(&y, b)| violated_bound(y, b))
                .collect();
            lateral = penalised_minimum(&violated, weight);
            if violated == std::mem::replace(&mut active, violated.clone()) {
                break;
            }
        }
    }
    lateral
}

/// Minimises `sum (y[i-1] - 2 y[i] + y[i+1])² + weight sum (y[i] - bound[i])²` over the violated bounds, by an `L D Lᵀ`
/// factorisation of the pentadiagonal system. At least two bounds must be violated.
fn penalised_minimum(bounds: &[Option<f64>], weight: f64) -> Vec<f64> {
    let n = bounds.len();
    let mut bands = vec![[0.0; 3]; n]; // entries (i, i), (i, i-1), (i, i-2)
    let mut y: Vec<f64> = bounds
        .iter()
        .map(|bound| bound.map_or(0.0, |at| weight * at))
        .collect();
    for (band, bound) in bands.iter_mut().zip(bounds) {
        band[0] = if bound.is_some() { weight } else { 0.0 };
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
