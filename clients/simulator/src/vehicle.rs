//! One simulated vehicle.

use std::sync::Arc;
use std::time::Instant;

use egp_path::{PathError, Projection, horizon_reference};
use egp_plant::{Plant, PlantError, VehicleId, VehicleState};
use egp_vehicle::{ClientError, Step, VehicleClient, VehicleConfig};
use thiserror::Error;

use crate::course::Course;

/// The car that is simulated.
pub const CAR: VehicleId = VehicleId::FordEscort;

/// Why a simulation ended.
#[derive(Debug, Error)]
pub enum SimulationError {
    /// The client reports an error.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The reference cannot be sampled.
    #[error(transparent)]
    Path(#[from] PathError),
    /// The plant has spun, or its state is not valid.
    #[error(transparent)]
    Plant(#[from] PlantError),
}

/// One control period of a simulated vehicle.
#[derive(Clone, Debug)]
pub struct Period {
    /// The result of the client's step.
    pub step: Step,
    /// The vehicle's projection on its path at the start of the period.
    pub projection: Projection,
    /// The vehicle's speed at the start, m/s.
    pub v_x: f64,
    /// The reference's speed at the start, m/s.
    pub v_reference: f64,
}

/// Plant, course and client of one vehicle.
pub struct SimulatedVehicle {
    client: VehicleClient,
    plant: Plant,
    course: Arc<Course>,
    s: f64,
    travelled: f64,
    reference: Vec<[f64; 4]>,
    widths: Vec<[f64; 2]>,
}

impl SimulatedVehicle {
    /// Connects a [`CAR`] and puts it on the course at arc length `s`, at its speed there.
    ///
    /// # Errors
    /// [`SimulationError`] if the service cannot be reached.
    pub fn connect(
        config: &VehicleConfig,
        course: Arc<Course>,
        s: f64,
    ) -> Result<Self, SimulationError> {
        let client = VehicleClient::connect(config)?;
        let stages = client.horizon() + 1;
        let mut vehicle = Self {
            client,
            plant: Plant::new(CAR.parameters()),
            course,
            s,
            travelled: 0.0,
            reference: vec![[0.0; 4]; stages],
            widths: vec![[0.0; 2]; stages],
        };
        vehicle.place(s)?;
        Ok(vehicle)
    }

    /// Puts the vehicle on the course at arc length `s`, with the speed of the profile there, and resets the client
    /// ([`VehicleClient::reset`]).
    ///
    /// # Errors
    /// [`SimulationError::Plant`].
    pub fn place(&mut self, s: f64) -> Result<(), SimulationError> {
        let sample = self.course.path.sample(s);
        self.plant.reset(&VehicleState {
            p_x: sample.x,
            p_y: sample.y,
            psi: sample.yaw,
            v_x: self.course.profile.speed(s),
            ..VehicleState::default()
        })?;
        self.client.reset();
        self.s = s;
        Ok(())
    }

    /// Control period, s.
    pub fn dt(&self) -> f64 {
        self.client.dt()
    }

    /// The onboard client.
    pub fn client(&self) -> &VehicleClient {
        &self.client
    }

    /// Arc length driven since the start, m.
    pub fn travelled(&self) -> f64 {
        self.travelled
    }

    /// Runs one control period that begins at `start`: measures, asks the service, and moves the plant.
    ///
    /// # Errors
    /// [`SimulationError`]; call [`SimulatedVehicle::place`] to go on.
    pub fn period(&mut self, start: Instant) -> Result<Period, SimulationError> {
        let dt = self.client.dt();
        let state = self.plant.vehicle_state();
        let projection = horizon_reference(
            &self.course.path,
            &self.course.profile,
            [state.p_x, state.p_y],
            state.psi,
            dt,
            Some(self.s),
            &mut self.reference,
            &mut self.widths,
        )?;
        self.advance(projection.s);
        let widths = if self.course.path.has_widths() {
            self.widths.as_slice()
        } else {
            &[]
        };
        let step = self
            .client
            .step_since(start, state.to_array(), &self.reference, widths)?;
        self.plant
            .step(step.command.u, dt, &self.course.road(projection.s))?;
        let v_reference = self.course.profile.speed(projection.s);
        Ok(Period {
            step,
            projection,
            v_x: state.v_x,
            v_reference,
        })
    }

    /// Adds the arc length between the last projection and this one, also across the start line.
    fn advance(&mut self, s: f64) {
        let length = self.course.path.length();
        let way = s - self.s;
        self.travelled += way - length * (way / length).round();
        self.s = s;
    }
}
