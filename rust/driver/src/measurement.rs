//! What a transport hands over at the start of a control period.

use egp_parameters::{
    MEASURED_SPEED, MOST_LATERAL_SPEED, MOST_STEERING_ANGLE, MOST_WIDTH, MOST_YAW_RATE,
    REFERENCE_SPEED,
};
use egp_wire::{FrictionRow, Invalid, ReferenceRow, State, WidthRow};
use thiserror::Error;

use crate::situation::wrap;

/// Between points closer than this, m, a reference has no direction to compare its yaw with.
const MIN_SPACING: f64 = 0.05;
/// Largest angle between a reference's yaw and the direction of its points, rad.
const MAX_DEVIATION: f64 = 0.5;
/// Length of a reference, m, up to which its speeds are not compared with its positions: a vehicle that starts or stops has
/// a short one.
const MIN_LENGTH: f64 = 2.0;
/// Largest ratio between the length of a reference and the distance that its speeds cover. Speeds in km/h cover 3.6 times
/// the length.
const MAX_RATIO: f64 = 3.0;

/// What the vehicle measured and where it is to go.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurement {
    /// Measured state `[p_x, p_y, v_x, psi, v_y, omega, delta]` in m, m, m/s, rad, m/s, rad/s, rad. One that is not
    /// finite or outside the domain of the control step (`docs/wire.md`, section 3) makes the period's command a stop.
    pub x: State,
    /// Rows `[p_x, p_y, v_x, psi]` for the stages 0..=T, row 0 = now; shape `[T+1, 4]`.
    pub reference: Vec<ReferenceRow>,
    /// Distances `[left, right]` from the reference to the track edges, m; `[T+1, 2]`, or empty for no edges.
    pub widths: Vec<WidthRow>,
    /// What is known about the road: rows of friction coefficient and standard deviation, first of the road on which
    /// the history was measured, then at the stages 0..=T; `[T+2, 2]`, or empty if nothing is known.
    pub road_friction: Vec<FrictionRow>,
}

/// Reference, widths or friction from which no request can be made. The control period was not opened.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InvalidArgument {
    /// A number of rows that does not fit the horizon.
    #[error(
        "{field}: expected {expected} rows (the horizon T = {horizon} and one more), got {got}"
    )]
    Rows {
        /// `reference` or `widths`.
        field: &'static str,
        /// Rows expected.
        expected: usize,
        /// T.
        horizon: usize,
        /// Rows that came.
        got: usize,
    },
    /// A yaw that does not point along the reference's own positions.
    #[error(
        "reference: row {row}: psi = {psi} rad differs by {deviation:.2} rad from the direction in which the positions \
         move; yaw is measured in rad, counter-clockwise from +x"
    )]
    Yaw {
        /// The row.
        row: usize,
        /// Its yaw, rad.
        psi: f64,
        /// The difference, rad.
        deviation: f64,
    },
    /// Speeds that contradict the reference's own positions.
    #[error(
        "reference: the positions of all rows are {length:.1} m apart in total, and the speeds v_x cover {covered:.1} m in \
         the same time; v_x is measured in m/s (1 m/s is 3.6 km/h), and rows are {dt} s apart"
    )]
    Speed {
        /// Sum of the distances between successive rows, m.
        length: f64,
        /// Distance that the speeds cover, m.
        covered: f64,
        /// Control period, s.
        dt: f64,
    },
    /// A value outside the domain of the wire.
    #[error(transparent)]
    Value(#[from] Invalid),
}

impl Measurement {
    /// Checks whether the control step plans for the measured state. If it does not, [`crate::Driver::tick`] decides on a
    /// stop, whatever the other fields are.
    ///
    /// # Errors
    /// [`Invalid`] naming the component that is not finite or outside its domain.
    pub fn check_state(&self) -> Result<(), Invalid> {
        egp_wire::check_state(&self.x)?;
        let [_, _, v_x, _, v_y, omega, delta] = self.x;
        let symmetric = |most: f64| (-most, most);
        for (name, unit, value, (least, most)) in [
            ("v_x", "m/s", v_x, MEASURED_SPEED),
            ("v_y", "m/s", v_y, symmetric(MOST_LATERAL_SPEED)),
            ("omega", "rad/s", omega, symmetric(MOST_YAW_RATE)),
            ("delta", "rad", delta, symmetric(MOST_STEERING_ANGLE)),
        ] {
            if !(least..=most).contains(&value) {
                let reason = format!(
                    "{name} = {value} {unit} is outside {least} to {most} {unit}; check unit, sign and frame"
                );
                return Err(Invalid::field("x", reason));
            }
        }
        Ok(())
    }

    /// Errors if reference or widths do not fit the horizon, hold a value outside the domain, or if the reference's yaw or
    /// speed contradicts its positions, which are `dt` s apart.
    pub(crate) fn check(&self, horizon: usize, dt: f64) -> Result<(), InvalidArgument> {
        let rows = |field, got: usize| {
            let expected = horizon + 1;
            if got == expected {
                return Ok(());
            }
            Err(InvalidArgument::Rows {
                field,
                expected,
                horizon,
                got,
            })
        };
        rows("reference", self.reference.len())?;
        if !self.widths.is_empty() {
            rows("widths", self.widths.len())?;
        }
        egp_wire::check_reference(&self.reference, &self.widths)?;
        egp_wire::check_road_friction(&self.road_friction, self.reference.len())?;
        self.check_speed()?;
        self.check_width()?;
        self.check_yaw()?;
        self.check_distance(dt)
    }

    fn check_speed(&self) -> Result<(), Invalid> {
        let (least, most) = REFERENCE_SPEED;
        let speeds = self.reference.iter().map(|row| row[2]);
        match speeds
            .enumerate()
            .find(|(_, v_x)| !(least..=most).contains(v_x))
        {
            None => Ok(()),
            Some((row, v_x)) => {
                let reason = format!("row {row}: v_x = {v_x} m/s is outside {least} to {most} m/s");
                Err(Invalid::field("reference", reason))
            }
        }
    }

    fn check_distance(&self, dt: f64) -> Result<(), InvalidArgument> {
        let pairs = self.reference.iter().zip(self.reference.iter().skip(1));
        let (length, covered) = pairs.fold((0.0, 0.0), |(length, covered), (here, next)| {
            let chord = (next[0] - here[0]).hypot(next[1] - here[1]);
            // Rows behind the end of a planner's path may repeat its last position.
            let mean = if chord > 0.0 {
                0.5 * (here[2] + next[2])
            } else {
                0.0
            };
            (length + chord, covered + mean * dt)
        });
        let (less, more) = (length.min(covered), length.max(covered));
        if less > MIN_LENGTH && more > MAX_RATIO * less {
            return Err(InvalidArgument::Speed {
                length,
                covered,
                dt,
            });
        }
        Ok(())
    }

    fn check_width(&self) -> Result<(), Invalid> {
        let beyond = |row: &WidthRow| row.iter().any(|width| width.abs() > MOST_WIDTH);
        let Some(row) = self.widths.iter().position(beyond) else {
            return Ok(());
        };
        let [left, right] = self.widths[row];
        let reason = format!(
            "row {row}: [{left}, {right}] m is beyond ±{MOST_WIDTH} m; no row at all means no edges"
        );
        Err(Invalid::field("widths", reason))
    }

    fn check_yaw(&self) -> Result<(), InvalidArgument> {
        let pairs = self.reference.iter().zip(self.reference.iter().skip(1));
        for (row, (here, next)) in pairs.enumerate() {
            let (dx, dy) = (next[0] - here[0], next[1] - here[1]);
            let deviation = wrap(dy.atan2(dx) - here[3]).abs();
            if dx.hypot(dy) > MIN_SPACING && deviation > MAX_DEVIATION {
                return Err(InvalidArgument::Yaw {
                    row,
                    psi: here[3],
                    deviation,
                });
            }
        }
        Ok(())
    }
}
