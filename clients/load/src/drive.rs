//! One vehicle on a fixed schedule.

use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use egp_simulator::{CAR, Course, Period, SimulatedVehicle, SimulationError};
use egp_vehicle::{ClientError, GateLimits, Mode, Unusable, VehicleConfig};
use egp_wire::Interrupt;

use crate::tally::Tally;
use crate::{Arguments, Failure};

/// Distance from its path, m, beyond which a vehicle counts as lost.
const LOST: f64 = 10.0;

/// What to do about a service that answers only vehicles with keys.
const WITHOUT_KEY: &str =
    "\nState the file of the keys of load/car-0 and so on with --key (`egp keys` makes it)";

/// What to do about a service that plans for another vehicle than the plant.
const OTHER_VEHICLE: &str = "\nThe simulated vehicles are the built-in car. If the library is that of another vehicle, send \
     a recording of its steps, which needs no simulated vehicle: `egp load --replay run.mcap`";

/// The times between which a vehicle is driven and counted.
pub(crate) struct Assignment {
    pub(crate) first: Instant,
    pub(crate) period: Duration,
    pub(crate) measure: Instant,
    pub(crate) end: Instant,
}

/// Connects vehicle `index`, placed at this part of the lap.
pub(crate) fn connect(
    arguments: &Arguments,
    index: u32,
    course: Arc<Course>,
    part: f64,
) -> Result<SimulatedVehicle, Failure> {
    let limits = GateLimits::of(&CAR.vehicle());
    let mut config = VehicleConfig::new("load", &format!("car-{index}"), limits, &[])?
        .reached_by(&arguments.connect, arguments.zenoh.as_deref());
    config.driver.budget = arguments.budget;
    config.publish_status = arguments.status;
    if let Some(file) = &arguments.key {
        config = config.with_key(file)?;
    }
    let s = part * course.path.length();
    SimulatedVehicle::connect(&config, course, s).map_err(|error| match error {
        // A service is there, but its answers cannot be used.
        SimulationError::Client(ClientError::NoReplica { reason, .. }) if !reason.0.is_empty() => {
            let is_without_key = |reason: &Unusable| *reason == Unusable::WithoutKey;
            let advice = if reason.0.values().any(is_without_key) {
                WITHOUT_KEY
            } else {
                OTHER_VEHICLE
            };
            format!("{reason}{advice}").into()
        }
        error => error.into(),
    })
}

/// Drives to the end of the schedule, or until Ctrl-C, and counts from `measure` on.
pub(crate) fn drive(
    mut vehicle: SimulatedVehicle,
    assignment: &Assignment,
    home: f64,
    interrupt: &Interrupt,
) -> Result<Tally, Failure> {
    let mut tally = Tally::default();
    let mut due = assignment.first;
    while due < assignment.end && !interrupt.came() {
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let lag = due.elapsed();
        let counted = due >= assignment.measure;
        let period = vehicle.period(due)?;
        if counted {
            tally.count(&period, lag);
        }
        if is_over(&period) {
            vehicle.place(home)?;
            tally.put_back += u64::from(counted);
        }
        due += assignment.period;
    }
    Ok(tally)
}

/// Whether the vehicle must be put back, because it has stopped for good, has spun, or is off the road.
fn is_over(period: &Period) -> bool {
    let stopped = period.step.command.mode == Mode::Stop && period.v_x < 0.1;
    stopped || period.moved.is_err() || period.projection.lateral.abs() > LOST
}
