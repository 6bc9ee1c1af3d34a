//! A lap with the controller inside the vehicle's own process:
//! `cargo run --release -p egp-engine --example in_process -- LIBRARY.safetensors`.

use egp_core::Settings;
use egp_driver::{DriverConfig, InProcessDriver, Measurement};
use egp_engine::Engine;
use egp_gate::Limits;
use egp_path::tracks::RoundedRectangle;
use egp_path::{HorizonRows, ReferenceStart, SpeedLimits, SpeedProfile, horizon_reference};
use egp_plant::{Plant, Uniform, VehicleId, VehicleState};
use egp_wire::Timing;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let library = std::env::args().nth(1).ok_or("which library file?")?;
    let engine = Engine::load(library.as_ref(), Settings::default())?;
    let vehicle = VehicleId::FordEscort.vehicle();
    let config = DriverConfig::new("depot", "car-7", Limits::of(&vehicle))?;
    let mut driver = InProcessDriver::new(config, engine.describe())?;
    let (mut workspace, dt) = (engine.workspace()?, engine.library().dt());

    let path = RoundedRectangle::default().path()?;
    let profile = SpeedProfile::new(&path, &SpeedLimits::of(&vehicle))?;
    let mut car = Plant::new(VehicleId::FordEscort.parameters());
    let (start, v_x) = (path.sample(0.0), profile.speed(0.0));
    car.reset(&VehicleState {
        p_x: start.x,
        p_y: start.y,
        psi: start.yaw,
        v_x,
        ..VehicleState::default()
    })?;

    let mut rows = HorizonRows::new(engine.describe().horizon as usize);
    let (mut s, mut worst) = (0.0, 0.0_f64);
    while s < path.length() - 1.0 {
        let x = car.vehicle_state();
        let start = ReferenceStart {
            position: [x.p_x, x.p_y],
            psi: x.psi,
            catch_up_from: None,
            hint: Some(s),
        };
        let projection = horizon_reference(&path, &profile, &start, dt, &mut rows)?;
        (s, worst) = (projection.s.max(s), worst.max(projection.lateral.abs()));
        let measurement = Measurement {
            x: x.to_array(),
            reference: rows.reference().to_vec(),
            widths: rows.widths().to_vec(),
            ..Measurement::default()
        };
        let step = driver.step(measurement, driver.driver().budget(), |request| {
            let mut reply = Vec::new();
            engine.step(&mut workspace, request, &mut reply)?;
            Ok((reply, Timing::default()))
        })?;
        car.step(step.command.u, dt, &Uniform::new(0.8)?)?;
    }
    println!("largest lateral error {worst:.2} m");
    Ok(())
}
