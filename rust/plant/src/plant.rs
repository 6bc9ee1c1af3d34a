//! The simulated vehicle.

use crate::axle::wheel_offsets;
use crate::dynamics::{KINEMATIC_SPEED, lateral_acceleration, roll_without_slip};
use crate::effects::Effects;
use crate::error::{check_forward_speed, finite};
use crate::integrator::{longest_substep, rk4};
use crate::state::{STATE_NAMES, StateVector, VehicleState, WHEELS, initial_state, settled};
use crate::{Disturbances, Friction, Parameters, PlantError, Surface};

/// A vehicle and its state.
///
/// Between substeps the plant corrects the states near standstill, for which [`crate::derivative`] is not valid: brakes
/// stop the vehicle but do not push it backward, locked wheels do not turn backward, the steering angle stays within
/// its stops, and below [`KINEMATIC_SPEED`] the wheels roll without slip (the offsets of the tyre forces would
/// otherwise accelerate a parked vehicle sideways by 0.2 m/s²).
#[derive(Clone, Debug)]
pub struct Plant {
    parameters: Parameters,
    effects: Effects,
    state: StateVector,
}

impl Plant {
    /// A vehicle at rest in the origin, heading along +x.
    ///
    /// The parameters are constants of the program and are not checked: masses, inertias, stiffnesses, lengths and the limits
    /// of the actuators must be positive and finite, and those of a real car, because [`Plant::step`] divides by them and
    /// chooses its substeps by them.
    pub fn new(parameters: Parameters) -> Self {
        let state = settled(&parameters, &VehicleState::default());
        let effects = Effects::new(&parameters, &Disturbances::default());
        Self {
            parameters,
            effects,
            state,
        }
    }

    /// Replaces the disturbances of the vehicle, which has none at first.
    ///
    /// The state is kept, so a load sinks into the springs during the first second. A vehicle that stands on a slope does
    /// not roll backward, and at walking speed neither wind nor bank move it sideways.
    ///
    /// # Errors
    /// [`PlantError::OutOfRange`] if a value is out of its range. The disturbances are then unchanged.
    pub fn disturb(&mut self, disturbances: &Disturbances) -> Result<(), PlantError> {
        disturbances.validate(&self.parameters)?;
        self.effects = Effects::new(&self.parameters, disturbances);
        Ok(())
    }

    /// The vehicle's parameters.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// All states, see [`crate::STATE_NAMES`].
    pub fn state(&self) -> &StateVector {
        &self.state
    }

    /// The states that a controller measures.
    pub fn vehicle_state(&self) -> VehicleState {
        VehicleState::of(&self.state)
    }

    /// Lateral acceleration of the body, m/s².
    pub fn lateral_acceleration(&self) -> f64 {
        lateral_acceleration(&self.parameters, &self.effects, &self.state)
    }

    /// Resets the vehicle to a state with its suspension at rest and its wheels rolling.
    ///
    /// # Errors
    /// Those of [`initial_state`]; the state is then unchanged.
    pub fn reset(&mut self, vehicle: &VehicleState) -> Result<(), PlantError> {
        self.state = initial_state(&self.parameters, vehicle)?;
        Ok(())
    }

    /// Sets all states.
    ///
    /// # Errors
    /// [`PlantError::NotFinite`], [`PlantError::Backward`], and [`PlantError::OutOfRange`] if `v_x` is above 100 m/s. The state
    /// is then unchanged.
    pub fn set_state(&mut self, state: &StateVector) -> Result<(), PlantError> {
        for (name, &value) in STATE_NAMES.into_iter().zip(state) {
            finite(name, value)?;
        }
        check_forward_speed(state[3])?;
        self.state = *state;
        Ok(())
    }

    /// Moves by `dt` seconds under the constant input `[F_x, delta_dot]` (N, rad/s).
    ///
    /// The surface is evaluated under each wheel once per substep (at most [`crate::MAX_SUBSTEP`]).
    ///
    /// # Errors
    /// [`PlantError`] if an input is invalid, or [`PlantError::Spun`] or [`PlantError::Diverged`] if the step fails.
    /// The state is then unchanged.
    pub fn step(
        &mut self,
        input: [f64; 2],
        dt: f64,
        friction: &(impl Friction + ?Sized),
    ) -> Result<(), PlantError> {
        check_step(input, dt)?;
        let mut state = self.state;
        let mut remaining = dt;
        while remaining > 0.0 {
            let surfaces = self.surfaces_under_wheels(&state, friction)?;
            // Equal substeps over the remaining time avoid a very short last substep.
            let count = (remaining / self.longest_substep(&state, &surfaces)).ceil();
            let h = remaining / count;
            state = self.substep(&state, input, h, &surfaces)?;
            remaining = if count > 1.0 { remaining - h } else { 0.0 };
        }
        self.state = state;
        Ok(())
    }

    fn substep(
        &self,
        state: &StateVector,
        [force, steering_rate]: [f64; 2],
        h: f64,
        surfaces: &[Surface; 4],
    ) -> Result<StateVector, PlantError> {
        let v_x = state[3];
        // Braking ends at standstill, which a substep that starts above walking speed cannot reach.
        let stopping = if v_x < KINEMATIC_SPEED {
            let mass = self.effects.mass;
            -mass * v_x / h - mass * self.effects.gravity[0]
        } else {
            f64::NEG_INFINITY
        };
        let input = [force.max(stopping), steering_rate];
        let mut next = rk4(&self.parameters, &self.effects, state, input, surfaces, h)?;
        if let Some(i) = next.iter().position(|value| !value.is_finite()) {
            return Err(PlantError::Diverged {
                name: STATE_NAMES[i],
                v_x,
            });
        }
        let stop = self.parameters.limits.steering_angle;
        next[2] = next[2].clamp(-stop, stop);
        if force < stopping {
            next[3] = next[3].max(0.0); // what is left is rounding
        }
        if next[3] < KINEMATIC_SPEED {
            roll_without_slip(&self.parameters, &mut next);
        }
        for wheel in &mut next[WHEELS] {
            *wheel = wheel.max(0.0);
        }
        Ok(next)
    }

    fn longest_substep(&self, state: &StateVector, surfaces: &[Surface; 4]) -> f64 {
        let mut stiffest = 1.0;
        for surface in surfaces {
            for stiffness in [surface.longitudinal.stiffness, surface.lateral.stiffness] {
                if stiffness > stiffest {
                    stiffest = stiffness;
                }
            }
        }
        let weight = self.effects.weight;
        longest_substep(&self.parameters, state[3], stiffest, weight)
    }

    /// The surface under each wheel as its tyre finds it.
    fn surfaces_under_wheels(
        &self,
        state: &StateVector,
        friction: &(impl Friction + ?Sized),
    ) -> Result<[Surface; 4], PlantError> {
        let [front, rear] = self.parameters.axles();
        let [a, b] = wheel_offsets(front);
        let [c, d] = wheel_offsets(rear);
        let (sin, cos) = state[4].sin_cos();
        let [new_front, new_rear] = self.effects.tyres;
        let contacts = [
            (front.position, a),
            (front.position, b),
            (rear.position, c),
            (rear.position, d),
        ];
        let mut surfaces = contacts.map(|(x, y)| {
            friction.surface([state[0] + x * cos - y * sin, state[1] + x * sin + y * cos])
        });
        for surface in &surfaces {
            surface.validate()?;
        }
        if new_front < 1.0 || new_rear < 1.0 {
            for (surface, left) in surfaces
                .iter_mut()
                .zip([new_front, new_front, new_rear, new_rear])
            {
                *surface = surface.worn(left);
            }
        }
        Ok(surfaces)
    }
}

/// Longest period, s: a longer one has another unit, and would take long.
const LONGEST_PERIOD: f64 = 100.0;

/// Errors unless the input is finite and the period positive and at most [`LONGEST_PERIOD`].
fn check_step(input: [f64; 2], dt: f64) -> Result<(), PlantError> {
    finite("F_x", input[0])?;
    finite("delta_dot", input[1])?;
    if dt > 0.0 && dt <= LONGEST_PERIOD {
        Ok(())
    } else {
        Err(PlantError::Period(dt))
    }
}
