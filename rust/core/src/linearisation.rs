//! Linearisation of the ensemble along an operating trajectory, eqs. (15)-(17), in closed form.

use egp_parameters::VehicleParameters;
use nalgebra::SMatrix;

use crate::settings::{Operating, OperatingSettings};
use crate::trajectory::Guess;
use crate::vehicle::{DELTA, OMEGA, V_X, V_Y, gp_input, jacobians, successor};
use crate::{Ensemble, GpJacobian, GpOutput, Input, NU, NX, State};

/// `x_{t+1} = A x_t + B u_t + c`, inputs in N and rad/s.
#[derive(Debug, Clone, PartialEq)]
pub struct AffineDynamics {
    /// `A_t`.
    pub a: SMatrix<f64, NX, NX>,
    /// `B_t`.
    pub b: SMatrix<f64, NX, NU>,
    /// `c_t`.
    pub c: State,
}

/// An operating trajectory and the dynamics along it.
#[derive(Debug, Clone)]
pub struct Linearisation {
    /// Operating states, stages `0..=T`.
    pub x: Vec<State>,
    /// Dynamics, stages `0..T`.
    pub stages: Vec<AffineDynamics>,
    /// Largest difference of lateral speed (m/s) or yaw rate (rad/s) between the state of a stage and its prediction from the
    /// stage before. Stage 1 does not count, because the measured state before it has noise.
    pub defect: f64,
}

/// Share of the largest operating `|v_y|` and `|omega|` by which a shifted state may differ from the ensemble's prediction.
const FAR: f64 = 0.5;

/// Box to which operating states are clamped.
#[derive(Debug, Clone, Copy)]
pub struct Domain {
    v_x: (f64, f64),
    v_y: f64,
    omega: f64,
    delta: f64,
}

impl Domain {
    /// The box of the settings for a vehicle, with the largest speed `v_x_max` in m/s.
    pub fn new(settings: &OperatingSettings, v_x_max: f64, vehicle: &VehicleParameters) -> Self {
        let [v_x_min, v_y, omega] = settings.limits(vehicle.scale());
        Self {
            v_x: (v_x_min, v_x_max.max(v_x_min)),
            v_y,
            omega,
            delta: vehicle.steering_angle,
        }
    }

    /// Whether lateral speed and yaw rate of a shifted state are near those that the ensemble predicts from the stage before.
    fn is_near(&self, planned: &State, predicted: &State) -> bool {
        let within = |i: usize, most: f64| (planned[i] - predicted[i]).abs() <= FAR * most;
        within(V_Y, self.v_y) && within(OMEGA, self.omega)
    }

    /// The nearest state in the box; positions and yaw are free.
    fn clamp(&self, mut x: State) -> State {
        x[V_X] = x[V_X].clamp(self.v_x.0, self.v_x.1);
        x[V_Y] = x[V_Y].clamp(-self.v_y, self.v_y);
        x[OMEGA] = x[OMEGA].clamp(-self.omega, self.omega);
        x[DELTA] = x[DELTA].clamp(-self.delta, self.delta);
        x
    }
}

/// How a state is carried to the next stage: period in s, and the part of the period at whose yaw the vehicle moves.
#[derive(Debug, Clone, Copy)]
struct Discretisation {
    dt: f64,
    yaw_at: f64,
}

impl Linearisation {
    /// Identity dynamics for a horizon of `horizon` inputs.
    pub fn new(horizon: usize) -> Self {
        let neutral = AffineDynamics {
            a: SMatrix::identity(),
            b: SMatrix::zeros(),
            c: State::zeros(),
        };
        Self {
            x: vec![State::zeros(); horizon + 1],
            stages: vec![neutral; horizon],
            defect: 0.0,
        }
    }

    /// Linearises the ensemble of each stage about the inputs of the guess and, with [`Operating::Shift`], about its states.
    /// Stages without a guessed state use the ensemble's prediction, and stage 0 is always the measured state `x0`.
    ///
    /// `models` gives the ensemble of a stage and what is added to the change that it predicts.
    ///
    /// If a guessed state is far from the prediction, all stages use the prediction. Over long horizons the errors of a
    /// linearisation grow along an unstable vehicle; about the plan that they lead to, the next errors would be larger.
    ///
    /// Values and slopes of the active members are evaluated once for each stage, and twice if a guessed state is far.
    /// Operating states are clamped to `domain`, in which the members have training data. The affine term is that of the clamped
    /// state, so the result still has the ensemble's value there. Its slopes are those of [`Ensemble::tangent`].
    pub fn along<'a>(
        &mut self,
        models: impl Fn(usize) -> (Ensemble<'a>, GpOutput),
        dt: f64,
        x0: &State,
        guess: &Guess,
        settings: &OperatingSettings,
        domain: &Domain,
    ) {
        self.x[0] = domain.clamp(*x0);
        let planned: &[State] = match settings.kind {
            Operating::Shift => &guess.x,
            Operating::Rollout => &[],
        };
        let step = Discretisation {
            dt,
            yaw_at: settings.yaw_at,
        };
        if !self.about(&models, step, planned, &guess.u, domain) {
            self.about(&models, step, &[], &guess.u, domain);
        }
    }

    /// Linearises about `planned` from stage 1 on, and about the prediction where it has no state. Returns whether all states
    /// are near their predictions; the stages are incomplete otherwise.
    fn about<'a>(
        &mut self,
        models: impl Fn(usize) -> (Ensemble<'a>, GpOutput),
        step: Discretisation,
        planned: &[State],
        u: &[Input],
        domain: &Domain,
    ) -> bool {
        self.defect = 0.0;
        for (t, (stage, u)) in self.stages.iter_mut().zip(u).enumerate() {
            let (dynamics, next) = tangent(&models(t), step, (&self.x[t], u));
            *stage = dynamics;
            let shifted = planned.get(t + 1);
            if shifted.is_some_and(|shifted| !domain.is_near(shifted, &next)) {
                return false;
            }
            if let (Some(shifted), 1..) = (shifted, t) {
                let difference = |i: usize| (shifted[i] - next[i]).abs();
                self.defect = self.defect.max(difference(V_Y)).max(difference(OMEGA));
            }
            self.x[t + 1] = domain.clamp(*shifted.unwrap_or(&next));
        }
        true
    }
}

/// The dynamics at one point, eq. (15), and its successor.
fn tangent(
    (ensemble, offset): &(Ensemble, GpOutput),
    Discretisation { dt, yaw_at }: Discretisation,
    (x, u): (&State, &Input),
) -> (AffineDynamics, State) {
    let mut slopes = GpJacobian::zeros();
    let change = ensemble.tangent(&gp_input(x, u), &mut slopes) + offset;
    let next = successor(x, u, &change, dt, yaw_at);
    let (a, b) = jacobians(x, &slopes, dt, yaw_at);
    (
        AffineDynamics {
            a,
            b,
            c: next - a * x - b * u,
        },
        next,
    )
}
