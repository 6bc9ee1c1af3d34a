//! The load generator: measures how many vehicles a service can keep on the road. It is the program `egp-load`, and the
//! command `egp load` of the Python package.

mod counts;
mod drive;
mod ramp;
mod recording;
mod replay;
mod report;
mod tally;
mod unsolved;

use std::ffi::OsString;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use std::{fs, io, thread};

use clap::{CommandFactory as _, FromArgMatches as _, Parser};
use egp_simulator::{Course, Track};
use egp_wire::{Interrupt, print_line, print_notice, replace_file, survive_file_size_limit};
use serde::Serialize;

use crate::drive::{Assignment, drive};
use crate::ramp::ramp;
use crate::replay::Replay;
use crate::report::Report;
use crate::tally::Tally;
use crate::unsolved::unsolved;

/// The text of `--help` behind the options.
const HELP: &str = r"Loads a running service with simulated vehicles and reports answer times and
errors.

    egp serve library.safetensors --workers 1
    egp load --vehicles 8 --seconds 20 --json load.json
    egp load --replay run.mcap --vehicles 32 --ramp 0.99 --seconds 5

Without Python the programs are egp-server and egp-load, and --requests takes
the place of --replay.

Each vehicle has its own zenoh session, the 29-state plant on a track of
changing friction, and the gate. The plant is the built-in car: a service
that plans for another vehicle is loaded with --requests. Requests are sent
on a fixed schedule (every control period of the library), whether or not the
last one was answered, and latency is measured from when a request was due,
so that a slow service cannot slow down its own test. A request that gets no
reply or is refused counts as slower than all others: a quantile that falls on
one is inf, and null in JSON. The vehicles' schedules are spread evenly over
the period.

A period is a miss if no solved plan came within the budget. The gate then
continues with the last plan (tail) and finally stops the vehicle; stopped,
spun or lost vehicles are put back on the track and counted.

With --requests the vehicles have no plant: each sends the requests of a
recording, whose library every replica must serve and at least one must
describe as its own (`library` of its configuration); `egp load --replay
run.mcap` extracts them from what `egp drive` writes. Sending them costs
little, so that this shows what the service carries. A request counts as in
time if its plan came within the budget from when it was due. With --ramp the
number of vehicles rises by a quarter as long as at least this fraction is in
time; --seconds is for each rate.

Look at `generator lag` first: the delay with which requests were sent because
this program or its machine was busy. If it is far above a millisecond, the
other times describe the generator instead of the service; give the generator
cores of its own or fewer vehicles.

If no request was solved, the exit code is 1, and a message says why. After
Ctrl-C the report is about the time until then, and the exit code is 130.";

/// Loads a running service with simulated vehicles and reports answer times and errors.
#[derive(Parser)]
#[command(version, long_about = HELP, max_term_width = 80)]
struct Arguments {
    /// Router or replica to connect to; may be given more than once. Default: the endpoints of --zenoh, or
    /// tcp/127.0.0.1:7447.
    #[arg(long)]
    connect: Vec<String>,
    /// Configuration of zenoh (JSON5), for TLS, certificates and the like.
    #[arg(long, value_name = "FILE")]
    zenoh: Option<PathBuf>,
    /// File with the secret keys of the cars load/car-0, load/car-1 and so on, made by `egp keys`.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Number of vehicles.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=LARGEST.into()))]
    vehicles: u32,
    /// Replay the requests of this file without a plant; for services without vehicle_keys.
    #[arg(long, value_name = "FILE", conflicts_with = "key")]
    requests: Option<PathBuf>,
    /// With --requests: share this many sessions of zenoh, as vehicles do behind routers; by default each has its own.
    #[arg(long, requires = "requests", value_parser = clap::value_parser!(u32).range(1..=LARGEST.into()))]
    sessions: Option<u32>,
    /// With --requests: raise the number of vehicles until less than this fraction of requests is answered in time.
    #[arg(long, value_name = "FRACTION", requires = "requests", value_parser = fraction)]
    ramp: Option<f64>,
    /// With --ramp: the largest number of vehicles.
    #[arg(long, requires = "ramp", default_value_t = LARGEST, value_parser = clap::value_parser!(u32).range(1..=LARGEST.into()))]
    most: u32,
    /// How long to measure, s, rounded up to whole control periods.
    #[arg(long, default_value = "20", value_parser = some_seconds)]
    seconds: Duration,
    /// How long to drive before measuring, s, rounded up in the same way.
    #[arg(long, default_value = "2", value_parser = seconds)]
    warm_up: Duration,
    /// Part of the control period that an answer may take, in (0, 1].
    #[arg(long, default_value_t = 0.8, value_parser = fraction)]
    budget: f64,
    /// Track: rectangle or l-shape.
    #[arg(long, default_value = "rectangle", conflicts_with = "requests")]
    track: Track,
    /// Friction coefficients along the track.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "0.5,0.8,1.1",
        conflicts_with = "requests"
    )]
    friction: Vec<f64>,
    /// Fraction of the grip to drive at, in (0, 1].
    #[arg(long, default_value_t = 0.7, conflicts_with = "requests")]
    grip: f64,
    /// Let the vehicles publish how they drive, for `egp monitor`.
    #[arg(long, conflicts_with = "requests")]
    status: bool,
    /// Write the report as JSON to this file.
    #[arg(long)]
    json: Option<PathBuf>,
}

/// The largest number of vehicles.
const LARGEST: u32 = 2000;

fn fraction(text: &str) -> Result<f64, String> {
    let value = text.parse().ok();
    value
        .filter(|value| *value > 0.0 && *value <= 1.0)
        .ok_or_else(|| "expected a number above 0 and up to 1".to_owned())
}

/// The longest time that can be asked for, s: one day.
const LONGEST: f64 = 86_400.0;

fn seconds(text: &str) -> Result<Duration, String> {
    let value = text.parse().ok();
    value
        .filter(|value| (0.0..=LONGEST).contains(value))
        .map(Duration::from_secs_f64)
        .ok_or_else(|| format!("expected a number of seconds from 0 to {LONGEST}"))
}

fn some_seconds(text: &str) -> Result<Duration, String> {
    let time = seconds(text).ok();
    time.filter(|time| !time.is_zero())
        .ok_or_else(|| format!("expected a number of seconds above 0 and up to {LONGEST}"))
}

/// The shortest time of whole periods that is not less than `time`.
fn whole_periods(time: Duration, period: Duration) -> Duration {
    let count = time.as_nanos().div_ceil(period.as_nanos().max(1));
    // At most a day of nanoseconds, each of which is a period.
    #[allow(clippy::cast_precision_loss)]
    period.mul_f64(count as f64)
}

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Measures, prints the result, and returns the exit code of a measurement that was done or interrupted.
fn run(arguments: &Arguments) -> Result<u8, Failure> {
    survive_file_size_limit()?;
    // A measurement is not lost because its report cannot be written.
    if let Some(path) = arguments.json.as_deref().filter(|path| path.is_dir()) {
        return Err(unwritten(path, &io::ErrorKind::IsADirectory.into()).into());
    }
    if let Some(path) = &arguments.json
        && let Some(folder) = path.parent().filter(|folder| *folder != Path::new(""))
    {
        fs::metadata(folder).map_err(|error| unwritten(path, &error))?;
    }
    let (interrupted, unsolved) = if let Some(file) = &arguments.requests {
        let mut replay = Replay::new(arguments, recording::read(file)?)?;
        let result = ramp(arguments, &mut replay, &Interrupt::watch()?)?;
        report(
            arguments,
            result.interrupted && result.rates.is_empty(),
            &result,
        )?;
        (result.interrupted, result.unsolved())
    } else {
        let (result, interrupted) = drive_all(arguments)?;
        report(
            arguments,
            interrupted && result.outcomes.is_empty(),
            &result,
        )?;
        (interrupted, unsolved(&result.outcomes))
    };
    match unsolved {
        _ if interrupted => Ok(Interrupt::STATUS),
        Some(reason) => Err(reason.into()),
        None => Ok(0),
    }
}

/// Prints a result, and writes it as JSON if that is asked for, unless Ctrl-C came before anything was measured.
fn report(
    arguments: &Arguments,
    nothing_measured: bool,
    result: &(impl Display + Serialize),
) -> Result<(), Failure> {
    if nothing_measured {
        print_notice("egp-load: interrupted before the measurement began");
        return Ok(());
    }
    // Each is done although the other one fails.
    let written = arguments.json.as_deref().map_or(Ok(()), |path| {
        let json = serde_json::to_vec_pretty(result)?;
        write_report(path, &json).map_err(|error| unwritten(path, &error).into())
    });
    print_line(result)?;
    written
}

/// Replaces the report's file, so that an earlier one stays if it cannot be written. What is no regular file, such as a pipe,
/// is written itself.
fn write_report(path: &Path, json: &[u8]) -> io::Result<()> {
    if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        return fs::write(path, json);
    }
    replace_file(path, json)
}

fn unwritten(path: &Path, error: &io::Error) -> String {
    let path = path.display();
    format!("cannot write the report {path}: {error}; choose another file for --json")
}

/// Drives simulated vehicles. Returns the result, and whether Ctrl-C ended the measurement before its time.
fn drive_all(arguments: &Arguments) -> Result<(Report, bool), Failure> {
    let course = Arc::new(Course::new(
        arguments.track,
        &arguments.friction,
        arguments.grip,
    )?);
    let vehicles: Vec<_> = (0..arguments.vehicles)
        .map(|index| {
            let part = f64::from(index) / f64::from(arguments.vehicles);
            drive::connect(arguments, index, course.clone(), part)
        })
        .collect::<Result<_, Failure>>()?;
    let interrupt = Arc::new(Interrupt::watch()?);
    // Schedules begin when all sessions are open, so that opening one does not disturb another.
    let begin = Instant::now() + Duration::from_millis(200);
    let count = vehicles.len();
    let period = (vehicles.first()).map_or(Duration::ZERO, |vehicle| {
        Duration::from_secs_f64(vehicle.dt())
    });
    let warm_up = whole_periods(arguments.warm_up, period);
    let measured = whole_periods(arguments.seconds, period);
    let threads: Vec<_> = vehicles
        .into_iter()
        .enumerate()
        .map(|(index, vehicle)| {
            let offset = period.mul_f64(index as f64 / count as f64);
            let first = begin + offset;
            let assignment = Assignment {
                first,
                period,
                measure: first + warm_up,
                end: first + warm_up + measured,
            };
            let length = course.path.length();
            let home = length * index as f64 / count as f64;
            let interrupt = interrupt.clone();
            thread::spawn(move || drive(vehicle, &assignment, home, &interrupt))
        })
        .collect();
    let mut total = Tally::default();
    for thread in threads {
        total.add(&thread.join().map_err(|_| "a vehicle's thread panicked")??);
    }
    let interrupted = interrupt.came();
    let measured = if interrupted {
        let part = total.periods as f64 / f64::from(arguments.vehicles);
        period.mul_f64(part).min(measured)
    } else {
        measured
    };
    let report = Report::new(&total, arguments.vehicles, measured);
    Ok((report, interrupted))
}

/// Runs the load generator with these arguments, of which the first is the name that the help shows, and returns the exit
/// code: 0 after a measurement, 1 if it failed or no request was solved, 2 for arguments that cannot be used, and 130 after
/// Ctrl-C. In a ramp, answers that come too late are a result.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let mut words = arguments.into_iter();
    let name = words.next().unwrap_or_else(|| "egp-load".into());
    // By itself clap would state an option that has a default value as one that is needed.
    let file = Path::new(&name).file_name().unwrap_or(&name);
    let usage = format!("{} [OPTIONS]", file.display());
    let command = Arguments::command().override_usage(usage);
    let matches = command.try_get_matches_from([name].into_iter().chain(words));
    let arguments = match matches.and_then(|matches| Arguments::from_arg_matches(&matches)) {
        Ok(arguments) => arguments,
        Err(answer) => {
            // Printing fails if the terminal was closed; there is no other place for the message.
            let _ = answer.print();
            return u8::from(answer.use_stderr()) * 2;
        }
    };
    match run(&arguments) {
        Ok(code) => code,
        Err(error) => {
            print_notice(format_args!("egp-load: {error}"));
            1
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_rounded_up_to_whole_periods() {
        let millis = Duration::from_millis;
        for (time, whole) in [
            (0, 0),
            (1, 20),
            (20, 20),
            (21, 40),
            (86_400_000, 86_400_000),
        ] {
            assert_eq!(whole_periods(millis(time), millis(20)), millis(whole));
        }
    }
}
