//! The 29 states, in the order of the CommonRoad multi-body vehicle.

use egp_parameters::{MOST_LATERAL_SPEED, MOST_STEERING_ANGLE, MOST_YAW_RATE};

use crate::error::{check_forward_speed, check_range, finite};
use crate::{Parameters, PlantError};

/// Number of states.
pub const NX: usize = 29;

/// All states; order and units in [`STATE_NAMES`].
pub type StateVector = [f64; NX];

/// Names with units. `z` points down; `_f`, `_r` are the unsprung masses, wheels are ordered by y (see the crate's
/// documentation), `joint` is the lateral displacement between the body and an axle.
pub const STATE_NAMES: [&str; NX] = [
    "p_x [m]",
    "p_y [m]",
    "delta [rad]",
    "v_x [m/s]",
    "psi [rad]",
    "omega [rad/s]",
    "roll [rad]",
    "roll_rate [rad/s]",
    "pitch [rad]",
    "pitch_rate [rad/s]",
    "v_y [m/s]",
    "z [m]",
    "v_z [m/s]",
    "roll_f [rad]",
    "roll_rate_f [rad/s]",
    "v_y_f [m/s]",
    "z_f [m]",
    "v_z_f [m/s]",
    "roll_r [rad]",
    "roll_rate_r [rad/s]",
    "v_y_r [m/s]",
    "z_r [m]",
    "v_z_r [m/s]",
    "wheel_f_minus_y [rad/s]",
    "wheel_f_plus_y [rad/s]",
    "wheel_r_minus_y [rad/s]",
    "wheel_r_plus_y [rad/s]",
    "joint_f [m]",
    "joint_r [m]",
];

/// Indices of the four wheel speeds.
pub(crate) const WHEELS: std::ops::Range<usize> = 23..27;

/// The seven states that a controller measures, `[p_x, p_y, v_x, psi, v_y, omega, delta]`, SI units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[allow(missing_docs)]
pub struct VehicleState {
    pub p_x: f64,
    pub p_y: f64,
    pub v_x: f64,
    pub psi: f64,
    pub v_y: f64,
    pub omega: f64,
    pub delta: f64,
}

impl VehicleState {
    /// The states in the controller's order.
    pub fn to_array(self) -> [f64; 7] {
        [
            self.p_x, self.p_y, self.v_x, self.psi, self.v_y, self.omega, self.delta,
        ]
    }

    /// From states in the controller's order.
    pub fn from_array([p_x, p_y, v_x, psi, v_y, omega, delta]: [f64; 7]) -> Self {
        Self {
            p_x,
            p_y,
            v_x,
            psi,
            v_y,
            omega,
            delta,
        }
    }

    /// The part of a full state that a controller measures.
    pub fn of(x: &StateVector) -> Self {
        Self::from_array([x[0], x[1], x[3], x[4], x[10], x[5], x[2]])
    }

    /// Errors unless all numbers are finite and lie in the ranges of measured states, the speed from 0 on.
    fn checked(self) -> Result<Self, PlantError> {
        const NAMES: [&str; 7] = ["p_x", "p_y", "v_x", "psi", "v_y", "omega", "delta"];
        for (name, value) in NAMES.into_iter().zip(self.to_array()) {
            finite(name, value)?;
        }
        check_forward_speed(self.v_x)?;
        for (name, unit, value, most) in [
            ("v_y", "m/s", self.v_y, MOST_LATERAL_SPEED),
            ("omega", "rad/s", self.omega, MOST_YAW_RATE),
            ("delta", "rad", self.delta, MOST_STEERING_ANGLE),
        ] {
            check_range(name, unit, value, (-most, most))?;
        }
        Ok(self)
    }
}

/// The full state with suspension and tyres in static balance and the wheels rolling.
///
/// This is the initial state of the original except for the body's height and pitch. The original leaves both at zero
/// although the tyres are compressed, which makes the wheel loads oscillate by a tenth in the first half second.
///
/// # Errors
/// [`PlantError::NotFinite`], [`PlantError::Backward`], and [`PlantError::OutOfRange`] unless `v_x` is at most 100 m/s, `v_y`
/// within ±50 m/s, `omega` within ±20 rad/s and `delta` within ±1.5 rad, as measured states of a control step are.
pub fn initial_state(
    parameters: &Parameters,
    vehicle: &VehicleState,
) -> Result<StateVector, PlantError> {
    Ok(settled(parameters, &vehicle.checked()?))
}

/// [`initial_state`] of a vehicle state known to be valid.
pub(crate) fn settled(parameters: &Parameters, vehicle: &VehicleState) -> StateVector {
    let [p_x, p_y, v_x, psi, v_y, omega, delta] = vehicle.to_array();
    let wheel_load = parameters.static_wheel_loads();
    let mut x = [0.0; NX];
    [x[0], x[1], x[2], x[3], x[4], x[5], x[10]] = [p_x, p_y, delta, v_x, psi, omega, v_y];
    let mut compression = [0.0; 2];
    for (i, axle) in parameters.axles().into_iter().enumerate() {
        compression[i] = wheel_load[i] / parameters.wheel.vertical_stiffness;
        x[15 + 5 * i] = v_y + axle.position * omega;
        x[16 + 5 * i] = compression[i];
    }
    // The springs carry the static load at zero travel: z - l pitch = compression at both axles.
    let pitch = (compression[1] - compression[0]) / parameters.wheelbase();
    [x[8], x[11]] = [pitch, compression[0] + parameters.front.position * pitch];
    x[WHEELS].fill(v_x / parameters.wheel.radius);
    x
}

/// Motion of the sprung mass.
#[derive(Clone, Copy)]
pub(crate) struct Body {
    pub delta: f64,
    pub v_x: f64,
    pub psi: f64,
    pub omega: f64,
    pub roll: f64,
    pub roll_rate: f64,
    pub pitch: f64,
    pub pitch_rate: f64,
    pub v_y: f64,
    pub z: f64,
    pub v_z: f64,
}

impl Body {
    pub fn of(x: &StateVector) -> Self {
        Self {
            delta: x[2],
            v_x: x[3],
            psi: x[4],
            omega: x[5],
            roll: x[6],
            roll_rate: x[7],
            pitch: x[8],
            pitch_rate: x[9],
            v_y: x[10],
            z: x[11],
            v_z: x[12],
        }
    }
}

/// Motion of one unsprung mass and its two wheels.
#[derive(Clone, Copy)]
pub(crate) struct AxleState {
    pub roll: f64,
    pub roll_rate: f64,
    pub v_y: f64,
    pub z: f64,
    pub v_z: f64,
    /// Wheel speeds, rad/s, the wheel at -y first.
    pub spin: [f64; 2],
    /// Lateral displacement in the joint, m.
    pub joint: f64,
}

impl AxleState {
    /// The front and the rear axle.
    pub fn both(x: &StateVector) -> [Self; 2] {
        [0, 1].map(|i| {
            let at = 13 + 5 * i;
            Self {
                roll: x[at],
                roll_rate: x[at + 1],
                v_y: x[at + 2],
                z: x[at + 3],
                v_z: x[at + 4],
                spin: [x[23 + 2 * i], x[24 + 2 * i]],
                joint: x[27 + i],
            }
        })
    }
}
