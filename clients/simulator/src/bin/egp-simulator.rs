//! `egp-simulator`: one simulated vehicle drives laps through a running service.

use std::io::{self, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Parser;
use egp_simulator::{CAR, Course, Period, SimulatedVehicle, Track};
use egp_vehicle::{
    GateLimits, Mode, Step, VehicleConfig, print_line, print_notice, survive_file_size_limit,
};

/// Below this speed, m/s, the car stands.
const STANDING: f64 = 0.1;
/// A car that stands this long gets no plan, or none that drives.
const PATIENCE: Duration = Duration::from_secs(5);

/// The text of `--help` behind the options.
const HELP: &str = r"Drives a simulated car through a running service, in real time.

Start the service first, then the car; on one machine they need no further
settings:

    egp-server --library surfaces.safetensors
    egp-simulator --friction 0.5,0.8,1.1 --grip 0.8

The track is divided evenly among the friction coefficients. The status line
shows where the car is, how far it is from the reference, where its commands
come from (NORMAL: a new plan; TAIL: the rest of the last one; STOP: braking,
because that has run out; WAITING: braking until the first plan), and the
weights of the library's surfaces. If you stop the service while the car
drives, you see TAIL, then STOP.";

/// Drives a simulated car through a running service, in real time.
#[derive(Parser)]
#[command(version, long_about = HELP)]
struct Arguments {
    /// Router or replica to connect to; may be given more than once. Default: the endpoints of --zenoh, or
    /// tcp/127.0.0.1:7447.
    #[arg(long)]
    connect: Vec<String>,
    /// Configuration of zenoh (JSON5), for TLS, certificates and the like.
    #[arg(long, value_name = "FILE")]
    zenoh: Option<PathBuf>,
    /// File with the secret key of the car, made by `egp keys`.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Fleet of the car.
    #[arg(long, default_value = "simulated")]
    fleet: String,
    /// Name of the car.
    #[arg(long, default_value = "car-1")]
    vehicle: String,
    /// Track: rectangle or l-shape.
    #[arg(long, default_value = "rectangle")]
    track: Track,
    /// Friction coefficients along the track.
    #[arg(long, value_delimiter = ',', default_value = "0.5,0.8,1.1")]
    friction: Vec<f64>,
    /// Fraction of the grip to drive at, in (0, 1].
    #[arg(long, default_value_t = 0.8)]
    grip: f64,
    /// Laps to drive.
    #[arg(long, default_value_t = 1)]
    laps: u32,
}

/// Largest errors and times of a drive.
#[derive(Default)]
struct Summary {
    periods: u32,
    missed: u32,
    lateral: f64,
    latency: Duration,
}

impl Summary {
    fn add(&mut self, period: &Period) {
        self.periods += 1;
        self.missed += u32::from(!period.step.outcome.is_solved());
        self.lateral = self.lateral.max(period.projection.lateral.abs());
        self.latency = self.latency.max(period.step.latency.unwrap_or_default());
    }
}

/// Why a car that drives no longer stands.
fn why_it_stands(step: &Step) -> String {
    let detail = step.outcome.detail();
    let reason = match &step.lost {
        Some(lost) => lost.to_string(),
        None if step.command.mode == Mode::Stop && step.outcome.is_solved() => {
            "the gate stopped it while no plan came, and it stays stopped until the vehicle is reset".to_owned()
        }
        None if step.outcome.is_solved() => "its plans do not drive".to_owned(),
        None if detail.is_empty() => "no plan came in time".to_owned(),
        None => format!("no plan came in time; the last answer: {detail}"),
    };
    format!("the car stands: {reason} (see --help)")
}

fn show(period: &Period, weights: &[f64]) {
    let weights: Vec<String> = weights
        .iter()
        .map(|weight| format!("{weight:.2}"))
        .collect();
    // The car drives on although nobody reads where it is.
    let _ = write!(
        io::stderr(),
        "\r s {:6.1} m  v {:4.1} m/s  lateral {:+.2} m  mu {:.2}  {:6}  weights {} ",
        period.projection.s,
        period.v_x,
        period.projection.lateral,
        period.projection.sample.friction,
        period.step.command.mode.name().to_uppercase(),
        weights.join(" "),
    );
}

fn run(arguments: &Arguments) -> Result<(), Box<dyn std::error::Error>> {
    survive_file_size_limit()?;
    let course = Arc::new(Course::new(
        arguments.track,
        &arguments.friction,
        arguments.grip,
    )?);
    let limits = GateLimits::of(&CAR.vehicle());
    let mut config = VehicleConfig::new(&arguments.fleet, &arguments.vehicle, limits, &[])?
        .reached_by(&arguments.connect, arguments.zenoh.as_deref());
    if let Some(file) = &arguments.key {
        config = config.with_key(file)?;
    }
    let mut vehicle = SimulatedVehicle::connect(&config, course.clone(), 0.0)?;
    print_notice(format_args!(
        "surfaces: {}",
        vehicle.client().members().join(", ")
    ));
    let way = course.path.length() * f64::from(arguments.laps);
    let (begin, period) = (Instant::now(), Duration::from_secs_f64(vehicle.dt()));
    let mut summary = Summary::default();
    let mut start = begin;
    let mut standing = Duration::ZERO;
    while vehicle.travelled() < way {
        std::thread::sleep(start.saturating_duration_since(Instant::now()));
        let driven = vehicle.period(start)?;
        summary.add(&driven);
        show(&driven, vehicle.client().weights());
        driven.moved?;
        standing = if driven.v_x < STANDING {
            standing + period
        } else {
            Duration::ZERO
        };
        if driven.step.command.mode == Mode::Stop && driven.v_x < STANDING || standing > PATIENCE {
            return Err(why_it_stands(&driven.step).into());
        }
        start += period;
    }
    print_notice("");
    print_line(format_args!(
        "{:.1} s, largest lateral error {:.2} m, {} of {} periods without a new plan, slowest answer {:.1} ms",
        begin.elapsed().as_secs_f64(),
        summary.lateral,
        summary.missed,
        summary.periods,
        summary.latency.as_secs_f64() * 1e3,
    ))?;
    Ok(())
}

#[allow(unsafe_code)]
fn main() -> ExitCode {
    let encrypted = egp_vehicle::ask_for_tls(std::env::args_os());
    // SAFETY: no other thread runs yet.
    unsafe { egp_vehicle::set_network_threads(encrypted) };
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            print_notice(format_args!("\negp-simulator: {error}"));
            ExitCode::FAILURE
        }
    }
}
