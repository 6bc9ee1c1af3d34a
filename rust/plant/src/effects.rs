//! What disturbances change in the equations of motion.

use crate::state::Body;
use crate::{Disturbances, GRAVITY, Parameters};

/// Density of the air at 15 °C and sea level (ISO 2533), kg/m³.
const AIR_DENSITY: f64 = 1.225;
/// Coefficient of the lateral force times its area, m²: 1.0 on the side of a saloon car of 4.2 m².
const SIDE_AREA: f64 = 4.2;

/// Mass, inertia and forces of a disturbed vehicle. Without disturbances each number is that of the parameters, and each
/// sum in the equations of motion gets a zero, so the results have the same bits.
///
/// A load moves the centres of mass. The equations keep the unloaded vehicle's centre as their reference point: moments
/// are taken about the common centre, and the difference `alpha r`, `omega² r` between the accelerations of both points
/// is neglected (r is 4 cm for 100 kg beside the seats).
#[derive(Clone, Debug)]
pub(crate) struct Effects {
    /// Mass of vehicle and load, kg.
    pub mass: f64,
    /// Yaw inertia about the common centre of mass, kg m².
    pub yaw_inertia: f64,
    /// Sprung mass with the load, kg.
    pub sprung_mass: f64,
    /// Roll inertia of the sprung mass with the load, kg m².
    pub roll_inertia: f64,
    /// Pitch inertia of the sprung mass with the load, kg m².
    pub pitch_inertia: f64,
    /// Position `[x, y]` of the centre of mass of vehicle and load, m.
    pub centre: [f64; 2],
    /// Position `[x, y]` of the centre of mass of sprung mass and load, m.
    pub sprung_centre: [f64; 2],
    /// Gravity in the road's axes: forward, left, down, m/s².
    pub gravity: [f64; 3],
    /// Share of the brake torque on each axle, front first.
    pub brake_share: [f64; 2],
    /// Factor on the brake torque of each wheel of an axle, the wheel at -y first.
    pub brake_side: [f64; 2],
    /// Share of peak force and stiffness that the tyres of each axle have, front first.
    pub tyres: [f64; 2],
    /// Weight of the load, N.
    pub weight: f64,
    wind: [f64; 2],
    wind_arm: f64,
}

impl Effects {
    /// The effects of disturbances that are within their ranges.
    pub fn new(parameters: &Parameters, disturbances: &Disturbances) -> Self {
        let &Disturbances {
            load,
            load_x,
            load_y,
            ..
        } = disturbances;
        let sprung = &parameters.sprung;
        let mass = parameters.mass + load;
        let sprung_mass = sprung.mass + load;
        // A point mass beside a body adds the reduced mass times the square of their distance to the inertia about the
        // common centre.
        let reduced = load * (parameters.mass / mass);
        let reduced_sprung = load * (sprung.mass / sprung_mass);
        let (sin_grade, cos_grade) = disturbances.grade.sin_cos();
        let (sin_bank, cos_bank) = disturbances.bank.sin_cos();
        Self {
            mass,
            yaw_inertia: parameters.yaw_inertia + reduced * (load_x * load_x + load_y * load_y),
            sprung_mass,
            roll_inertia: sprung.roll_inertia + reduced_sprung * load_y * load_y,
            pitch_inertia: sprung.pitch_inertia + reduced_sprung * load_x * load_x,
            centre: [load_x, load_y].map(|at| load / mass * at),
            sprung_centre: [load_x, load_y].map(|at| load / sprung_mass * at),
            gravity: [
                -GRAVITY * sin_grade,
                -GRAVITY * cos_grade * sin_bank,
                GRAVITY * cos_grade * cos_bank,
            ],
            brake_share: [
                parameters.front.brake_share + disturbances.brake_bias,
                parameters.rear.brake_share - disturbances.brake_bias,
            ],
            brake_side: [1.0 - disturbances.brake_pull, 1.0 + disturbances.brake_pull],
            tyres: [1.0 - disturbances.wear_front, 1.0 - disturbances.wear_rear],
            weight: load * GRAVITY,
            wind: [disturbances.wind_x, disturbances.wind_y],
            wind_arm: disturbances.wind_arm,
        }
    }

    /// Lateral force of the wind, N: `F = 1/2 rho c A V² sin(beta)`, where `V` is the speed of the air relative to the
    /// vehicle and `V sin(beta)` the wind's component across it. The vehicle's own lateral speed and drag are neglected.
    pub fn wind_force(&self, body: &Body) -> f64 {
        let [x, y] = self.wind;
        if x == 0.0 && y == 0.0 {
            return 0.0;
        }
        let (sin, cos) = body.psi.sin_cos();
        let along = x * cos + y * sin - body.v_x;
        let across = y * cos - x * sin;
        0.5 * AIR_DENSITY * SIDE_AREA * (along * along + across * across).sqrt() * across
    }

    /// Yaw moment about the common centre of mass beyond the moment of the road about the reference point, N m.
    ///
    /// `force` is the sum `[x, y]` of road and wind, N. Gravity acts in the common centre and has no moment about it.
    pub fn yaw_moment(&self, force: [f64; 2], wind: f64) -> f64 {
        self.wind_arm * wind - (self.centre[0] * force[1] - self.centre[1] * force[0])
    }
}
