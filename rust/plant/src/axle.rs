//! Forces at one axle: suspension, compliant joint and the two tyres.
//!
//! The equations of both axles are the same; the steering angle of the rear axle is zero. With its lateral position
//! `y = -T/2, +T/2` each wheel has the same equations, too.

use crate::parameters::{Axle, Parameters};
use crate::state::{AxleState, Body};
use crate::tyre::Contact;
use crate::{PlantError, Surface, TyreForce};

/// An axle in a given state.
pub(crate) struct AxleModel<'a> {
    pub vehicle: &'a Parameters,
    pub axle: &'a Axle,
    pub body: &'a Body,
    pub state: &'a AxleState,
    /// Steering angle of this axle, rad.
    pub steering: f64,
    /// Static load of one spring, N.
    pub static_spring_load: f64,
}

/// Forces that depend on positions and velocities alone.
pub(crate) struct Suspension {
    /// Spring, damper and anti-roll force at each wheel, N.
    pub spring: [f64; 2],
    /// Camber of each wheel, rad.
    pub camber: [f64; 2],
    /// Lateral force of the compliant joint, N.
    pub joint: f64,
    /// Rate of the joint's lateral displacement, m/s.
    pub joint_rate: f64,
}

/// Forces and moments of the road on the axle, in the vehicle's axes.
pub(crate) struct Road {
    /// Vertical load of each wheel, N.
    pub load: [f64; 2],
    /// Tyre forces in each wheel's axes.
    pub tyre: [TyreForce; 2],
    /// Forward force, N.
    pub x: f64,
    /// Lateral force, N.
    pub y: f64,
    /// Yaw moment about the centre of mass, N m.
    pub yaw_moment: f64,
    /// Sine and cosine of the axle's roll.
    pub roll: (f64, f64),
}

/// Lateral positions of the wheels of an axle.
pub(crate) fn wheel_offsets(axle: &Axle) -> [f64; 2] {
    [-0.5 * axle.track_width, 0.5 * axle.track_width]
}

impl AxleModel<'_> {
    pub fn suspension(&self) -> Suspension {
        let (body, state, axle) = (self.body, self.state, self.axle);
        let radius = self.vehicle.wheel.radius;
        let rest = self.vehicle.sprung.height - radius;
        let (sin_roll, cos_roll) = body.roll.sin_cos();

        let height = rest + state.z - body.z;
        let height_rate = state.v_z - body.v_z;
        let tilt = body.roll - state.roll;
        let tilt_rate = body.roll_rate - state.roll_rate;

        let heave = height / cos_roll - rest + axle.position * body.pitch;
        let heave_rate = height_rate + axle.position * body.pitch_rate;
        let anti_roll = tilt * axle.torsion / axle.track_width;
        let offsets = wheel_offsets(axle);
        let travel = offsets.map(|y| heave - y * tilt);
        let spring = [0, 1].map(|i| {
            let y = offsets[i];
            let travel_rate = heave_rate - y * tilt_rate;
            self.static_spring_load
                - travel[i] * axle.spring
                - travel_rate * axle.damper
                - y.signum() * anti_roll
        });
        let camber = [0, 1].map(|i| body.roll - offsets[i].signum() * axle.camber_gain * travel[i]);

        let lever = axle.roll_axis_height - radius;
        let (sin_tilt, cos_tilt) = tilt.sin_cos();
        let joint_rate = body.v_y + axle.position * body.omega - state.v_y;
        let stretch = height * sin_roll - state.joint * cos_roll - lever * sin_tilt;
        let stretch_rate = (height * cos_roll + state.joint * sin_roll) * body.roll_rate
            + height_rate * sin_roll
            - joint_rate * cos_roll
            - lever * cos_tilt * tilt_rate;
        let joint =
            stretch * self.vehicle.joint.stiffness + stretch_rate * self.vehicle.joint.damping;

        Suspension {
            spring,
            camber,
            joint,
            joint_rate,
        }
    }

    /// Speed of each contact along its wheel, m/s.
    pub fn contact_speeds(&self) -> [f64; 2] {
        let (sin, cos) = self.steering.sin_cos();
        let v_y = self.body.v_y + self.axle.position * self.body.omega;
        wheel_offsets(self.axle).map(|y| (self.body.v_x - y * self.body.omega) * cos + v_y * sin)
    }

    /// Tyre forces. `slipping` is false at walking speed, where slip is undefined and set to zero.
    ///
    /// # Errors
    /// Index on this axle and speed of a wheel contact that moves backward.
    pub fn road(
        &self,
        camber: [f64; 2],
        surfaces: [&Surface; 2],
        slipping: bool,
    ) -> Result<Road, (usize, f64)> {
        let (body, state) = (self.body, self.state);
        let wheel = &self.vehicle.wheel;
        let offsets = wheel_offsets(self.axle);
        let (sin_roll, cos_roll) = state.roll.sin_cos();
        let (sin, cos) = self.steering.sin_cos();
        let v_y =
            body.v_y + self.axle.position * body.omega - state.roll_rate * (wheel.radius - state.z);
        let speeds = self.contact_speeds();

        let load = offsets.map(|y| {
            (state.z + wheel.radius * (cos_roll - 1.0) + y * sin_roll) * wheel.vertical_stiffness
        });
        let mut tyre = [TyreForce { x: 0.0, y: 0.0 }; 2];
        for i in 0..2 {
            let (slip, slip_angle) = if slipping {
                if speeds[i] <= 0.0 {
                    return Err((i, speeds[i]));
                }
                // As in CommonRoad's original. In a spin, `v_x` can be negative while the steered wheel still rolls forward;
                // the slip angle then refers to the opposite direction of motion.
                let v_x = body.v_x - offsets[i] * body.omega;
                (
                    1.0 - wheel.radius * state.spin[i] / speeds[i],
                    (v_y / v_x).atan() - self.steering,
                )
            } else {
                (0.0, 0.0)
            };
            let contact = Contact {
                slip,
                slip_angle,
                camber: camber[i],
                load: load[i],
                surface: surfaces[i],
            };
            tyre[i] = self.vehicle.tyre.force(&contact);
        }

        let force_x = tyre[0].x + tyre[1].x;
        let force_y = tyre[0].y + tyre[1].y;
        let x = force_x * cos - force_y * sin;
        let y = force_y * cos + force_x * sin;
        let couple: f64 = (0..2)
            .map(|i| offsets[i] * (tyre[i].y * sin - tyre[i].x * cos))
            .sum();
        Ok(Road {
            load,
            tyre,
            x,
            y,
            yaw_moment: self.axle.position * y + couple,
            roll: (sin_roll, cos_roll),
        })
    }

    /// Roll moment on the unsprung mass, N m.
    pub fn unsprung_roll_moment(&self, suspension: &Suspension, road: &Road) -> f64 {
        let wheel = &self.vehicle.wheel;
        let (sin_roll, cos_roll) = road.roll;
        let wheels: f64 = wheel_offsets(self.axle)
            .into_iter()
            .enumerate()
            .map(|(i, y)| {
                let arm = wheel.radius * sin_roll
                    - y * cos_roll
                    - wheel.lateral_compliance * road.tyre[i].y;
                y * suspension.spring[i] + road.load[i] * arm
            })
            .sum();
        wheels
            - suspension.joint * (self.axle.roll_axis_height - wheel.radius)
            - road.y * (wheel.radius - self.state.z)
    }

    /// Roll moment on the sprung mass, N m.
    pub fn sprung_roll_moment(&self, suspension: &Suspension) -> f64 {
        let radius = self.vehicle.wheel.radius;
        let springs: f64 = wheel_offsets(self.axle)
            .into_iter()
            .zip(suspension.spring)
            .map(|(y, force)| y * force)
            .sum();
        let arm = self.vehicle.sprung.height - self.body.z - radius + self.state.z
            - (self.axle.roll_axis_height - radius) * self.state.roll.cos();
        -springs - suspension.joint / self.body.roll.cos() * arm
    }
}

/// The error for a backward-moving contact, given its axle and the error of [`AxleModel::road`].
pub(crate) fn spun(axle: usize, (wheel, speed): (usize, f64)) -> PlantError {
    PlantError::Spun {
        wheel: 2 * axle + wheel,
        speed,
    }
}
