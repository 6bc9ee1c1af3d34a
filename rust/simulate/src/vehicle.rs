//! One vehicle: plant, course and driver.

use std::time::Duration;

use egp_driver::{Driver, DriverConfig, Measurement, RunKey};
use egp_gate::{Limits, Mode};
use egp_path::{HorizonRows, ReferenceStart, horizon_reference};
use egp_plant::{Plant, VehicleState};
use egp_wire::{KeyRing, Ready};

use crate::mutant::Mutant;
use crate::oracle::VehicleOracles;
use crate::scene::{CAR, Scene, SimulationError};

/// The fleet of all vehicles.
pub(crate) const FLEET: &str = "fleet";
/// Control periods that the rest of a plan may bridge, as the oracle has it.
const MAX_TAIL: u64 = 25;
/// Below this speed, m/s, a stopped vehicle is put back on its course. The force of a stop decreases before it.
const STANDSTILL: f64 = 0.1;

/// A vehicle on the course.
pub(crate) struct Vehicle {
    pub(crate) driver: Driver,
    pub(crate) oracles: VehicleOracles,
    plant: Plant,
    s: f64,
    /// The command of the last period.
    pub(crate) u: [f64; 2],
    /// How far its clock is ahead.
    pub(crate) clock: Duration,
    /// Deadline of the present period on the simulation's clock.
    pub(crate) deadline: Duration,
    /// Queries that have not ended, with their replica and when the last message for each is due.
    pub(crate) outstanding: Vec<(egp_driver::QueryId, usize, Duration)>,
}

impl Vehicle {
    pub(crate) fn new(
        index: usize,
        scene: &Scene,
        served: Ready,
        keys: Option<&KeyRing>,
        mutant: Option<Mutant>,
    ) -> Result<Self, SimulationError> {
        let text = format!("car-{index}");
        let limits = Limits::of(&CAR.vehicle());
        let mut config = DriverConfig::new(FLEET, &text, limits)?;
        if let Some(keys) = keys {
            let key = keys.get(&config.fleet, &config.vehicle)?.clone();
            let run = index as u64;
            config.key = Some(RunKey { key, run });
        }
        if mutant == Some(Mutant::LongTail) {
            config.max_tail_ticks = Some(3 * MAX_TAIL);
        }
        let mut vehicle = Self {
            oracles: VehicleOracles::new(limits, served.dt, MAX_TAIL),
            driver: Driver::new(config, served)?,
            plant: Plant::new(CAR.parameters()),
            s: 0.0,
            u: [0.0; 2],
            clock: Duration::ZERO,
            deadline: Duration::ZERO,
            outstanding: Vec::new(),
        };
        vehicle.place(scene, 25.0 * index as f64)?;
        Ok(vehicle)
    }

    /// Puts the vehicle on the course at the course's speed, and forgets the past.
    fn place(&mut self, scene: &Scene, s: f64) -> Result<(), SimulationError> {
        let sample = scene.path.sample(s);
        self.plant.reset(&VehicleState {
            p_x: sample.x,
            p_y: sample.y,
            psi: sample.yaw,
            v_x: scene.profile.speed(s),
            ..VehicleState::default()
        })?;
        self.driver.reset();
        self.oracles.reset();
        self.s = s;
        Ok(())
    }

    /// Lets the plant drive one period with the last command, and puts a vehicle that has stopped, spun or left the road
    /// back on its course. Returns whether that was so.
    pub(crate) fn drive(&mut self, scene: &Scene, dt: f64) -> Result<bool, SimulationError> {
        let surfaces = scene.path.surfaces_near(Some(self.s));
        let moved = self.plant.step(self.u, dt, &surfaces);
        let stopped = matches!(self.driver.mode(), Mode::Stop | Mode::Waiting)
            && self.plant.vehicle_state().v_x < STANDSTILL;
        if moved.is_err() || stopped {
            self.place(scene, self.s)?;
            return Ok(true);
        }
        Ok(false)
    }

    /// What the vehicle measures.
    pub(crate) fn measure(&mut self, scene: &Scene) -> Result<Measurement, SimulationError> {
        let served = self.driver.served();
        let mut rows = HorizonRows::new(served.horizon as usize);
        let state = self.plant.vehicle_state();
        let start = ReferenceStart {
            position: [state.p_x, state.p_y],
            psi: state.psi,
            catch_up_from: None,
            hint: Some(self.s),
        };
        let projection =
            horizon_reference(&scene.path, &scene.profile, &start, served.dt, &mut rows)?;
        self.s = projection.s;
        let (reference, mut widths) = rows.into_parts();
        if !scene.path.has_widths() {
            widths.clear();
        }
        Ok(Measurement {
            x: state.to_array(),
            reference,
            widths,
            road_friction: Vec::new(),
        })
    }

    /// Present speed, m/s, and steering angle, rad; both are measured without an error, and change between control periods
    /// only.
    pub(crate) fn motion(&self) -> [f64; 2] {
        let state = self.plant.vehicle_state();
        [state.v_x, state.delta]
    }
}
