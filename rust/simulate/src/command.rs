//! The program `egp-simulate`, which is also the command `egp simulate` of the Python package.

use std::ffi::OsString;
use std::io::{self, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};

use clap::Parser;
use egp_wire::{Interrupt, print_line, print_notice, survive_file_size_limit};

use crate::{Config, Run, Scene, ScheduledFault, SimulationError, planted, repeat};

/// Simulate vehicles, replicas, routers and the network between them in virtual time, with faults drawn from a seed.
#[derive(Parser)]
#[command(version, max_term_width = 80)]
struct Program {
    /// Library that vehicles ask for.
    library: PathBuf,
    /// Another library, which a replica serves after a reload and which some vehicles ask for.
    #[arg(long)]
    other: PathBuf,
    #[command(flatten)]
    options: Options,
}

/// Simulate vehicles, replicas, routers and the network between them in virtual time, with faults drawn from a seed.
#[derive(Parser)]
#[command(version, max_term_width = 80)]
struct Options {
    /// Replay this seed and print its trace.
    #[arg(long, conflicts_with_all = ["seeds", "planted"])]
    seed: Option<u64>,
    /// Run the seeds A to B, A..B without B.
    #[arg(long, value_parser = seeds, default_value = "0..20", conflicts_with = "planted")]
    seeds: std::ops::Range<u64>,
    /// Print which oracle finds each planted fault.
    #[arg(long, conflicts_with_all = ["seconds", "vehicles", "routers", "replicas"])]
    planted: bool,
    /// With --seed: this fault in place of those of the seed; may be given more than once. WHAT:WHERE@BEGIN+LENGTH, s:
    /// kill:r0@1.5+2 kills replica 0 and starts it again after 2 s, and so freeze, slow, restart, drain, reload,
    /// other-library, hostile, disorder, flood and replica-clock; router-kill:router-0@1+2, router-restart and router-freeze
    /// are those of a router; partition:car-0:r1@1+0.5 cuts a link, half-open loses its answers;
    /// vehicle-clock:car-0@1+0 lets a clock jump.
    #[arg(long, value_name = "FAULT", requires = "seed", conflicts_with_all = ["seeds", "planted"])]
    fault: Vec<ScheduledFault>,
    /// Virtual duration of a run, s; at most a day.
    #[arg(long, default_value_t = 10.0, value_parser = seconds)]
    seconds: f64,
    /// Number of vehicles, 1 to 100.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=100))]
    vehicles: u8,
    /// Number of routers, 0 to 2; by default as the seed has it, and none in three of five seeds.
    #[arg(long, value_parser = clap::value_parser!(u8).range(0..=2))]
    routers: Option<u8>,
    /// Number of replicas, 1 to 100.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=100))]
    replicas: u8,
}

fn seconds(text: &str) -> Result<f64, String> {
    const LONGEST: f64 = 86_400.0;
    let value = text.parse().ok();
    value
        .filter(|value| *value > 0.0 && *value <= LONGEST)
        .ok_or_else(|| format!("expected a number of seconds above 0 and up to {LONGEST}"))
}

fn seeds(text: &str) -> Result<std::ops::Range<u64>, String> {
    let bounds = text.split_once("..");
    let parsed = bounds.and_then(|(a, b)| Some(a.parse().ok()?..b.parse().ok()?));
    parsed
        .filter(|range: &std::ops::Range<u64>| !range.is_empty())
        .ok_or_else(|| format!("expected A..B with A below B, such as 0..1000, got {text}"))
}

/// Replays one seed with a readable trace, runs many seeds, or shows which oracle finds each planted fault.
///
/// The first of the arguments is the name that the help shows. Returns the exit code: 0 if no promise was broken and every
/// planted fault was found, 1 otherwise, 2 if the simulation cannot run or for arguments that cannot be used, and 130 if Ctrl-C
/// ended a run of many seeds, whose results until then are printed. If the reader of the output closes it, the program ends
/// early, and the code is that of what was found until then.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    finished(Program::try_parse_from(arguments), |program| {
        run(&program.options, &program.library, &program.other)
    })
}

/// As [`main`], with these libraries, which the arguments then do not name.
pub fn main_with_libraries(
    arguments: impl IntoIterator<Item = OsString>,
    library: &Path,
    other: &Path,
) -> u8 {
    finished(Options::try_parse_from(arguments), |options| {
        run(options, library, other)
    })
}

/// Runs the simulation with arguments that were read, and returns the exit code.
fn finished<T>(
    parsed: Result<T, clap::Error>,
    run: impl FnOnce(&T) -> Result<u8, SimulationError>,
) -> u8 {
    let options = match parsed {
        Ok(options) => options,
        Err(answer) => {
            // Printing fails if the terminal was closed; there is no other place for the message.
            let _ = answer.print();
            return u8::from(answer.use_stderr()) * 2;
        }
    };
    match run(&options) {
        Ok(code) => code,
        Err(error) => {
            print_notice(format_args!("egp-simulate: {error}"));
            2
        }
    }
}

/// Runs what the options ask for, and returns the exit code.
fn run(options: &Options, library: &Path, other: &Path) -> Result<u8, SimulationError> {
    survive_file_size_limit()?;
    let late = |fault: &&ScheduledFault| fault.begin.as_secs_f64() >= options.seconds;
    if let Some(fault) = options.fault.iter().find(late) {
        return Err(SimulationError::Late(*fault, options.seconds));
    }
    let scene = Scene::load(library, other)?;
    let config = |seed| Config {
        seconds: options.seconds,
        vehicles: options.vehicles.into(),
        replicas: options.replicas.into(),
        routers: options
            .routers
            .map_or(Config::new(seed).routers, usize::from),
        faults: options.fault.clone(),
        ..Config::new(seed)
    };
    if options.planted {
        return Ok(u8::from(!planted::print(&scene)?));
    }
    if let Some(seed) = options.seed {
        let run = repeat(
            &scene,
            &Config {
                recorded: true,
                ..config(seed)
            },
        )?;
        if !run.trace.is_empty() {
            print_line(run.trace.join("\n"))?;
        }
        report(seed, &run)?;
        return Ok(u8::from(!run.violations.is_empty()));
    }
    let Hunt {
        seeds,
        sound,
        interrupted,
        total,
    } = hunt(&scene, options.seeds.clone(), config)?;
    let hours = total.periods as f64 * scene.period() / 3600.0;
    print_line(format_args!(
        "{}{seeds} seeds, {hours:.3} vehicle-hours, {} faults, {} of {} periods with a reply: {}",
        if interrupted {
            "interrupted after "
        } else {
            ""
        },
        total.faults,
        total.replied,
        total.periods,
        if sound {
            "no oracle was violated, and every seed repeats"
        } else {
            "violated"
        }
    ))?;
    Ok(if interrupted {
        Interrupt::STATUS
    } else {
        u8::from(!sound)
    })
}

/// What came of many seeds.
struct Hunt {
    /// Number of seeds that were run.
    seeds: usize,
    /// Whether none of them broke a promise.
    sound: bool,
    /// Whether Ctrl-C came before the last one.
    interrupted: bool,
    /// The sums of all runs.
    total: Run,
}

/// Runs many seeds, until Ctrl-C comes, and prints those that broke a promise.
fn hunt(
    scene: &Scene,
    seeds: std::ops::Range<u64>,
    config: impl Fn(u64) -> Config,
) -> Result<Hunt, SimulationError> {
    let interrupt = Interrupt::watch()?;
    let (mut done, mut sound, mut total) = (0, true, Run::default());
    let (count, terminal) = (seeds.clone().count(), io::stderr().is_terminal());
    for seed in seeds {
        if interrupt.came() {
            break;
        }
        let run = repeat(scene, &config(seed))?;
        done += 1;
        if !run.violations.is_empty() {
            sound = false;
            if !report(seed, &run)? {
                break;
            }
        }
        total.periods += run.periods;
        total.replied += run.replied;
        total.faults += run.faults;
        if terminal {
            let filled = 40 * done / count;
            let bar = "#".repeat(filled);
            // A bar that cannot be drawn is no reason to stop.
            let _ = write!(io::stderr(), "\r[{bar:40}] {done} of {count} seeds");
        }
    }
    if terminal {
        print_notice("");
    }
    Ok(Hunt {
        seeds: done,
        sound,
        interrupted: interrupt.came() && done < count,
        total,
    })
}

/// Prints what was broken; returns whether anybody reads on.
fn report(seed: u64, run: &Run) -> io::Result<bool> {
    for violation in &run.violations {
        print_line(format_args!(
            "seed {seed}: {:?} broken at {:.6} s: {}",
            violation.oracle,
            violation.at.as_secs_f64(),
            violation.detail
        ))?;
    }
    print_line(format_args!(
        "seed {seed}: trace {:016x}, {} of {} periods with a reply, {} oracles violated",
        run.hash,
        run.replied,
        run.periods,
        run.violations.len()
    ))
}

#[cfg(test)]
mod tests {
    use clap::error::ErrorKind;

    use super::*;

    fn parsed(options: &[&str]) -> Result<Options, clap::Error> {
        Options::try_parse_from(["egp simulate"].iter().chain(options))
    }

    #[test]
    fn scheduled_faults_are_for_one_seed() {
        let fault = ["--fault", "kill:r0@1+1"];
        assert!(parsed(&["--seed", "1", fault[0], fault[1]]).is_ok());
        for other in [&[][..], &["--seeds", "0..2"], &["--planted"]] {
            assert!(parsed(&[other, &fault].concat()).is_err(), "{other:?}");
        }
    }

    #[test]
    fn the_usage_names_the_libraries_only_where_they_are_arguments() {
        let usage = |error: Option<clap::Error>| error.map_or_else(String::new, |e| e.to_string());
        let own = Program::try_parse_from(["egp-simulate", "--nonsense"]);
        assert!(usage(own.err()).contains("--other <OTHER>"));
        let inside = usage(parsed(&["--nonsense"]).err());
        assert!(
            inside.contains("[OPTIONS]") && !inside.contains("--other"),
            "{inside}"
        );
    }

    #[test]
    fn options_of_a_run_are_errors_beside_the_planted_faults() {
        assert!(parsed(&["--planted"]).is_ok_and(|options| options.planted));
        for (option, value) in [
            ("--seconds", "1"),
            ("--vehicles", "3"),
            ("--replicas", "3"),
            ("--routers", "0"),
            ("--seeds", "0..20"),
            ("--seed", "0"),
        ] {
            assert!(parsed(&[option, value]).is_ok(), "{option}");
            let error = parsed(&["--planted", option, value]).err();
            let kind = error.map(|error| error.kind());
            assert_eq!(kind, Some(ErrorKind::ArgumentConflict), "{option}");
        }
    }
}
