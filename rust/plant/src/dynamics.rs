//! The right-hand side of the 29 differential equations.

use crate::axle::{AxleModel, Road, Suspension, spun};
use crate::effects::Effects;
use crate::state::{AxleState, Body, NX, StateVector, WHEELS};
use crate::{Disturbances, Parameters, PlantError, Surface};

/// Speed, m/s, below which slip is undefined and the vehicle moves as a kinematic single track.
pub const KINEMATIC_SPEED: f64 = 0.1;

/// `dx/dt` for the input `[F_x, delta_dot]` (N, rad/s) and the surface under each wheel (front -y, front +y,
/// rear -y, rear +y), without disturbances.
///
/// The input is first saturated by the actuator limits. As in the original, the load of a lifted wheel is negative,
/// which pulls the vehicle down and reverses the tyre force. The equations are therefore not realistic above a lateral
/// acceleration of about 9 m/s², where the inner rear wheel of vehicle 1 lifts. `x` must be finite.
///
/// # Errors
/// [`PlantError::Spun`] if a wheel contact moves backward above [`KINEMATIC_SPEED`].
pub fn derivative(
    parameters: &Parameters,
    x: &StateVector,
    input: [f64; 2],
    surfaces: &[Surface; 4],
) -> Result<StateVector, PlantError> {
    let effects = Effects::new(parameters, &Disturbances::default());
    disturbed_derivative(parameters, &effects, x, input, surfaces)
}

/// [`derivative`] of a disturbed vehicle. The wear of the tyres is already in `surfaces`.
pub(crate) fn disturbed_derivative(
    parameters: &Parameters,
    effects: &Effects,
    x: &StateVector,
    input: [f64; 2],
    surfaces: &[Surface; 4],
) -> Result<StateVector, PlantError> {
    let body = Body::of(x);
    let states = AxleState::both(x);
    let axles = axles(parameters, &body, &states);
    let acceleration = parameters
        .limits
        .acceleration(body.v_x, input[0] / parameters.mass);
    let steering_rate = parameters.limits.steering_rate(body.delta, input[1]);
    let slipping = body.v_x.abs() >= KINEMATIC_SPEED;

    let suspension = [axles[0].suspension(), axles[1].suspension()];
    let front = axles[0]
        .road(suspension[0].camber, [&surfaces[0], &surfaces[1]], slipping)
        .map_err(|wheel| spun(0, wheel))?;
    let rear = axles[1]
        .road(suspension[1].camber, [&surfaces[2], &surfaces[3]], slipping)
        .map_err(|wheel| spun(1, wheel))?;
    let road = [front, rear];

    let sprung = &parameters.sprung;
    let sum_x = road[0].x + road[1].x;
    let wind = effects.wind_force(&body);
    let force = [sum_x, road[0].y + road[1].y + wind];
    let yaw_moment = road[0].yaw_moment + road[1].yaw_moment + effects.yaw_moment(force, wind);
    let springs = suspension.each_ref().map(|s| s.spring[0] + s.spring[1]);
    let lift = springs[0] + springs[1];
    let roll_moment = axles[0].sprung_roll_moment(&suspension[0])
        + axles[1].sprung_roll_moment(&suspension[1])
        + effects.sprung_centre[1] * lift;
    let (sin_roll, cos_roll) = body.roll.sin_cos();
    let joints = suspension[0].joint + suspension[1].joint;
    let centripetal = body.omega * body.v_x;

    let mut f = [0.0; NX];
    f[2] = steering_rate;
    if slipping {
        let (sin, cos) = body.psi.sin_cos();
        f[0] = body.v_x * cos - body.v_y * sin;
        f[1] = body.v_x * sin + body.v_y * cos;
        f[3] = sum_x / effects.mass + body.omega * body.v_y + effects.gravity[0];
        f[4] = body.omega;
        let product = sprung.roll_yaw_product / effects.roll_inertia;
        f[5] = (yaw_moment + product * roll_moment)
            / (effects.yaw_inertia - sprung.roll_yaw_product * product);
    } else {
        let net = acceleration * (parameters.mass / effects.mass) + effects.gravity[0];
        kinematic(parameters, &body, [net, steering_rate], &mut f);
    }

    f[6] = body.roll_rate;
    let product = sprung.roll_yaw_product / effects.yaw_inertia;
    f[7] = (product * yaw_moment + roll_moment)
        / (effects.roll_inertia - sprung.roll_yaw_product * product);
    f[8] = body.pitch_rate;
    f[9] = (axles[0].axle.position * springs[0]
        + axles[1].axle.position * springs[1]
        + sum_x * (sprung.height - body.z)
        - effects.sprung_centre[0] * lift)
        / effects.pitch_inertia;
    f[10] = sprung_lateral_acceleration(effects, (sin_roll, cos_roll), &suspension, wind)
        - centripetal
        + effects.gravity[1];
    f[11] = body.v_z;
    f[12] = effects.gravity[2] - (lift * cos_roll - joints * sin_roll) / effects.sprung_mass;

    for (i, model) in axles.iter().enumerate() {
        let (suspension, road, at) = (&suspension[i], &road[i], 13 + 5 * i);
        let motion = unsprung(effects, model, suspension, road, (sin_roll, cos_roll));
        f[at..at + 5].copy_from_slice(&motion);
        f[at + 2] = f[at + 2] - centripetal + effects.gravity[1];
        let at = WHEELS.start + 2 * i;
        f[at..at + 2].copy_from_slice(&spins(effects, i, model, road, acceleration));
        f[27 + i] = suspension.joint_rate;
    }
    Ok(f)
}

/// Slopes of an axle's roll, lateral motion and heave, without the centripetal acceleration and the gravity across the road.
/// The last argument is sine and cosine of the body's roll.
fn unsprung(
    effects: &Effects,
    model: &AxleModel,
    suspension: &Suspension,
    road: &Road,
    (sin_roll, cos_roll): (f64, f64),
) -> [f64; 5] {
    let (axle, state) = (model.axle, model.state);
    let spring = suspension.spring[0] + suspension.spring[1];
    let lift = road.load[0] + road.load[1] + suspension.joint * sin_roll - spring * cos_roll;
    [
        state.roll_rate,
        model.unsprung_roll_moment(suspension, road) / axle.roll_inertia,
        (road.y - suspension.joint * cos_roll - spring * sin_roll) / axle.unsprung_mass,
        state.v_z,
        effects.gravity[2] - lift / axle.unsprung_mass,
    ]
}

/// Angular accelerations of the wheels of axle `i`, rad/s², at this acceleration of the drive or the brakes, m/s².
fn spins(
    effects: &Effects,
    i: usize,
    model: &AxleModel,
    road: &Road,
    acceleration: f64,
) -> [f64; 2] {
    let (parameters, spin) = (model.vehicle, model.state.spin);
    let (share, side) = if acceleration > 0.0 {
        (model.axle.drive_share, [1.0; 2])
    } else {
        (effects.brake_share[i], effects.brake_side)
    };
    let torque = 0.5 * share * parameters.mass * parameters.wheel.radius * acceleration;
    [0, 1].map(|w| {
        // A locked wheel does not turn backward.
        if spin[w] < 0.0 {
            0.0
        } else {
            (side[w] * torque - parameters.wheel.radius * road.tyre[w].x) / parameters.wheel.inertia
        }
    })
}

/// Lateral acceleration of the sprung mass, m/s², as measured by an accelerometer in the body, which does not feel
/// gravity.
///
/// It depends on suspension, joints and wind only, so neither input nor surface is needed.
pub(crate) fn lateral_acceleration(
    parameters: &Parameters,
    effects: &Effects,
    x: &StateVector,
) -> f64 {
    let body = Body::of(x);
    let states = AxleState::both(x);
    let suspension = axles(parameters, &body, &states).map(|axle| axle.suspension());
    let wind = effects.wind_force(&body);
    sprung_lateral_acceleration(effects, body.roll.sin_cos(), &suspension, wind)
}

/// Sets yaw rate, lateral speeds and wheel speeds to those of the kinematic single track with rolling wheels.
pub(crate) fn roll_without_slip(parameters: &Parameters, x: &mut StateVector) {
    let (beta, yaw_rate) = single_track(parameters, x[2], x[3]);
    x[5] = yaw_rate;
    x[10] = x[3] * beta.tan();
    for (i, axle) in parameters.axles().into_iter().enumerate() {
        x[15 + 5 * i] = x[10] + axle.position * yaw_rate;
    }
    let body = Body::of(x);
    let states = AxleState::both(x);
    let rolling = axles(parameters, &body, &states).map(|axle| axle.contact_speeds());
    for (spin, speed) in x[WHEELS].iter_mut().zip(rolling.into_iter().flatten()) {
        *spin = speed / parameters.wheel.radius;
    }
}

/// Slip angle of the centre of mass and yaw rate of the kinematic single track,
/// `beta = atan(tan(delta) b / l)`, `omega = v cos(beta) tan(delta) / l`.
fn single_track(parameters: &Parameters, delta: f64, speed: f64) -> (f64, f64) {
    let wheelbase = parameters.wheelbase();
    let tan = delta.tan();
    let beta = (tan * -parameters.rear.position / wheelbase).atan();
    (beta, speed * beta.cos() * tan / wheelbase)
}

fn axles<'a>(
    parameters: &'a Parameters,
    body: &'a Body,
    states: &'a [AxleState; 2],
) -> [AxleModel<'a>; 2] {
    let load = parameters.static_spring_loads();
    let model = |i: usize, axle, steering| AxleModel {
        vehicle: parameters,
        axle,
        body,
        state: &states[i],
        steering,
        static_spring_load: load[i],
    };
    [
        model(0, &parameters.front, body.delta),
        model(1, &parameters.rear, 0.0),
    ]
}

/// [`lateral_acceleration`], given sine and cosine of the body's roll and the force of the wind.
fn sprung_lateral_acceleration(
    effects: &Effects,
    (sin_roll, cos_roll): (f64, f64),
    suspension: &[Suspension; 2],
    wind: f64,
) -> f64 {
    let force: f64 = suspension
        .iter()
        .map(|s| s.joint * cos_roll + (s.spring[0] + s.spring[1]) * sin_roll)
        .sum();
    (force + wind) / effects.sprung_mass
}

/// Planar motion at walking speed: a kinematic single track about the centre of mass.
fn kinematic(
    parameters: &Parameters,
    body: &Body,
    [acceleration, steering_rate]: [f64; 2],
    f: &mut StateVector,
) {
    let (beta, yaw_rate) = single_track(parameters, body.delta, body.v_x);
    f[0] = body.v_x * (beta + body.psi).cos();
    f[1] = body.v_x * (beta + body.psi).sin();
    f[3] = acceleration;
    f[4] = yaw_rate;

    let wheelbase = parameters.wheelbase();
    let to_rear = -parameters.rear.position;
    let (tan, cos) = (body.delta.tan(), body.delta.cos());
    // The original uses the roll angle instead of the slip angle and squares the whole of tan(delta)^2 b / l. Both
    // errors are negligible at this speed and are kept for parity.
    let square = (tan * tan * to_rear / wheelbase).powi(2);
    let beta_rate = to_rear * steering_rate / (wheelbase * cos * cos * (1.0 + square));
    let (sin_roll, cos_roll) = body.roll.sin_cos();
    f[5] = (acceleration * cos_roll * tan - body.v_x * sin_roll * beta_rate * tan
        + body.v_x * cos_roll * steering_rate / (cos * cos))
        / wheelbase;
}
