//! One simulated vehicle.

use std::sync::Arc;
use std::time::Instant;

use egp_path::{HorizonRows, PathError, Projection, ReferenceStart, horizon_reference};
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
    /// How the plant moved. After an error the vehicle must be put back ([`SimulatedVehicle::place`]).
    pub moved: Result<(), PlantError>,
}

/// Plant, course and client of one vehicle.
pub struct SimulatedVehicle {
    client: VehicleClient,
    plant: Plant,
    course: Arc<Course>,
    s: f64,
    travelled: f64,
    rows: HorizonRows,
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
        let mut vehicle = Self {
            rows: HorizonRows::new(client.horizon()),
            client,
            plant: Plant::new(CAR.parameters()),
            course,
            s,
            travelled: 0.0,
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
    /// [`SimulationError`].
    pub fn period(&mut self, start: Instant) -> Result<Period, SimulationError> {
        let dt = self.client.dt();
        let state = self.plant.vehicle_state();
        let from = ReferenceStart {
            position: [state.p_x, state.p_y],
            psi: state.psi,
            catch_up_from: None,
            hint: Some(self.s),
        };
        let Course { path, profile } = &*self.course;
        let projection = horizon_reference(path, profile, &from, dt, &mut self.rows)?;
        self.advance(projection.s);
        let widths = if self.course.path.has_widths() {
            self.rows.widths()
        } else {
            &[]
        };
        let step =
            self.client
                .step_since(start, state.to_array(), self.rows.reference(), widths)?;
        let surfaces = self.course.path.surfaces_near(Some(projection.s));
        let moved = self.plant.step(step.command.u, dt, &surfaces);
        Ok(Period {
            step,
            projection,
            v_x: state.v_x,
            moved,
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
