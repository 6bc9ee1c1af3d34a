//! Requests that own their data.

use std::sync::OnceLock;

use crate::libraries;
use egp_core::{Kernel, Library, Settings, StepReply, StepRequest, Workspace, step};

/// A small library of two surfaces.
pub fn library() -> &'static Library {
    static LIBRARY: OnceLock<Library> = OnceLock::new();
    LIBRARY.get_or_init(|| libraries::library(Kernel::Rbf, &[0.5, 1.1], 250, 3))
}

/// The default settings with a horizon of 20 and a window of 10, for short run times. The vehicle of
/// `libraries::change` reaches its largest force at slip angles of 0.3 rad on every surface.
pub fn settings() -> Settings {
    let mut settings = Settings {
        horizon: Some(20),
        ..Settings::default()
    };
    settings.weights.window = Some(10);
    settings.soft.slip = Some(0.6);
    settings
}

/// A request that owns its data: a vehicle on a left-hand circle of 60 m radius at 14 m/s, half a metre off the circle.
#[derive(Clone)]
pub struct Request {
    /// Measured state.
    pub x: [f64; 7],
    /// Input applied now.
    pub u_prev: [f64; 2],
    /// Weights of the last reply; empty before the first one.
    pub weights: Vec<f64>,
    /// States of the last plan, row by row; empty before the first one.
    pub plan_x: Vec<f64>,
    /// Inputs of the last plan, row by row.
    pub plan_u: Vec<f64>,
    /// Control periods since row 0 of the last plan.
    pub plan_shift: u32,
    /// GP inputs of the last transitions, newest first, row by row.
    pub history_z: Vec<f64>,
    /// GP outputs of the same transitions, row by row.
    pub history_y: Vec<f64>,
    /// Predictions of the members for the oldest transitions, row by row.
    pub history_f: Vec<f64>,
    /// Reference `[p_x, p_y, v_x, psi]` of the stages, row by row.
    pub reference: Vec<f64>,
    /// Distances `[left, right]` to the edges of the track, row by row.
    pub widths: Vec<f64>,
    /// Friction of the road and its standard deviation, row by row.
    pub road_friction: Vec<f64>,
}

impl Request {
    /// A cold request with a full history and a track of 6 m width, for [`settings`].
    pub fn circle() -> Self {
        Self::circle_of(20, 10)
    }

    /// The same for a horizon of `horizon` stages and a history of `window` transitions.
    pub fn circle_of(horizon: u32, window: u32) -> Self {
        let (radius, speed, dt) = (60.0, 14.0, 0.05);
        let reference = (0..=horizon).flat_map(|t| {
            let angle = speed * dt * f64::from(t) / radius;
            [
                radius * angle.sin(),
                radius * (1.0 - angle.cos()),
                speed,
                angle,
            ]
        });
        let history = |i: u32| {
            [
                13.5 + 0.1 * f64::from(i),
                0.05,
                0.2,
                0.04,
                500.0 - 90.0 * f64::from(i),
                0.01,
            ]
        };
        Self {
            x: [0.1, -0.5, 13.0, 0.05, 0.02, 0.1, 0.03],
            u_prev: [300.0, 0.05],
            weights: vec![],
            plan_x: vec![],
            plan_u: vec![],
            plan_shift: 1,
            history_z: (0..window).flat_map(history).collect(),
            history_y: (0..window)
                .flat_map(|i| [0.01, 0.02 - 0.001 * f64::from(i), 0.005])
                .collect(),
            history_f: vec![],
            reference: reference.collect(),
            widths: [3.0, 3.0].repeat(horizon as usize + 1),
            road_friction: vec![],
        }
    }

    /// The request as the control step takes it.
    pub fn borrow(&self) -> StepRequest<'_> {
        StepRequest {
            x: &self.x,
            u_prev: &self.u_prev,
            weights: &self.weights,
            plan_x: &self.plan_x,
            plan_u: &self.plan_u,
            plan_shift: self.plan_shift,
            history_z: &self.history_z,
            history_y: &self.history_y,
            history_f: &self.history_f,
            reference: &self.reference,
            widths: &self.widths,
            road_friction: &self.road_friction,
            want_sigma: false,
        }
    }

    /// The same situation turned by `angle` about the origin and moved by `by`.
    #[must_use]
    pub fn moved(&self, angle: f64, by: [f64; 2]) -> Self {
        let (sin, cos) = angle.sin_cos();
        let mut moved = self.clone();
        let place = |p: &mut [f64], psi: usize| {
            (p[0], p[1]) = (
                cos * p[0] - sin * p[1] + by[0],
                sin * p[0] + cos * p[1] + by[1],
            );
            p[psi] += angle;
        };
        place(&mut moved.x, 3);
        moved.reference.chunks_mut(4).for_each(|row| place(row, 3));
        moved.plan_x.chunks_mut(7).for_each(|row| place(row, 3));
        moved
    }

    /// Copies plan, weights and predictions of `reply`, as a client does for its next request.
    pub fn carry(&mut self, reply: &StepReply) {
        self.plan_x.clone_from(&reply.plan_x);
        self.plan_u.clone_from(&reply.plan_u);
        self.weights.clone_from(&reply.weights);
        self.history_f.clone_from(&reply.history_f);
    }
}

/// One step with a fresh workspace.
pub fn solve(request: &Request, settings: &Settings) -> StepReply {
    let mut reply = StepReply::default();
    let mut ws = Workspace::new(library(), settings).unwrap();
    step(library(), settings, &request.borrow(), &mut ws, &mut reply).unwrap();
    reply
}

/// A warm request: the circle with the plan of a cold start.
pub fn warm() -> Request {
    let mut request = Request::circle();
    request.carry(&solve(&request, &settings()));
    request.plan_shift = 0;
    request
}
