//! A vehicle that plans its speed for the friction that it believes in.

use egp_map::RoadBelief;
use egp_parameters::{FRICTION_HYPOTHESES, VehicleParameters, friction_hypotheses};
use egp_path::tracks::RandomTrack;
use egp_path::{SpeedLimits, SpeedPlanner};

/// Speed of the vehicle in m/s.
const SPEED: f64 = 14.0;
/// Control period in s.
const DT: f64 = 0.05;
/// Risk of the reference speed.
const RISK: f64 = 0.05;

/// What a vehicle computes in a control period beside its control step, in the second lap of a road of 500 m with two
/// surfaces.
#[derive(Debug, Clone)]
pub struct Planning {
    /// What is believed about the road.
    pub belief: RoadBelief,
    planner: SpeedPlanner,
    length: f64,
    s: f64,
    friction: Vec<f64>,
    places: Vec<f64>,
    road_friction: Vec<[f64; 2]>,
}

impl Planning {
    /// A vehicle whose control step has `horizon` stages; with `reports`, another vehicle reported all that this one found
    /// in its first lap.
    pub fn new(horizon: usize, reports: bool) -> Self {
        let path = RandomTrack::new(0).path().unwrap();
        let limits = SpeedLimits::of(&VehicleParameters::FORD_ESCORT);
        let planner = SpeedPlanner::new(&path, &limits).unwrap();
        let belief = RoadBelief::new(path.length(), true).unwrap();
        let mut planning = Self {
            belief,
            length: path.length(),
            s: 0.0,
            friction: vec![0.0; planner.places()],
            planner,
            places: vec![0.0; horizon + 1],
            road_friction: vec![[0.0; 2]; horizon + 2],
        };
        planning.drive(planning.length);
        if reports {
            for index in 0..planning.belief.tiles() {
                let tile = planning.belief.tile(index).unwrap();
                planning.belief.report(index, &tile).unwrap();
            }
        }
        planning.drive(planning.length / 3.0);
        planning.period();
        planning
    }

    fn drive(&mut self, distance: f64) {
        let mut driven = 0.0;
        while driven < distance {
            self.update();
            driven += SPEED * DT;
        }
    }

    /// Drives one period further, and adds what the control step found.
    pub fn update(&mut self) {
        self.s = (self.s + SPEED * DT) % self.length;
        let mu: f64 = if self.s < 0.5 * self.length { 0.9 } else { 0.5 };
        let evidence: [f64; FRICTION_HYPOTHESES] =
            friction_hypotheses().map(|hypothesis| -0.5 * ((hypothesis / mu).ln() / 0.1).powi(2));
        self.belief.update(self.s, Some(&evidence)).unwrap();
    }

    /// The friction to plan for ahead of the vehicle.
    pub fn ahead(&mut self) -> &[f64] {
        let (start, step) = (self.planner.start(self.s), self.planner.step());
        self.belief
            .ahead(start, step, RISK, &mut self.friction)
            .unwrap();
        &self.friction
    }

    /// Plans the speed for the friction that [`Self::ahead`] wrote; returns the time of the plan in s.
    pub fn plan(&mut self) -> f64 {
        let plan = self.planner.plan(self.s, Some(SPEED), &self.friction);
        plan.unwrap().lap_time()
    }

    /// The `road_friction` of the control step's request.
    pub fn preview(&mut self) -> &[[f64; 2]] {
        for (stage, place) in self.places.iter_mut().enumerate() {
            *place = self.s + SPEED * DT * stage as f64;
        }
        self.belief
            .preview(&self.places, &mut self.road_friction)
            .unwrap();
        &self.road_friction
    }

    /// All of a period.
    pub fn period(&mut self) -> &[[f64; 2]] {
        self.update();
        self.ahead();
        self.plan();
        self.preview()
    }
}
