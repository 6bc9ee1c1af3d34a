//! `egp-server`: serves a library until SIGTERM or SIGINT.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{ArgGroup, Parser};
use egp_core::library::hex;
use egp_service::{ServiceConfig, ServiceSignals, serve};
use egp_wire::{print_line, print_notice};

/// The text of `--help` behind the options.
const HELP: &str = r#"Answers the control steps of vehicles over zenoh.

Try it on this machine:

    egp-server --library surfaces.safetensors

In production, write a TOML file and pass it as --config; options of the
command line override the file:

    library = "surfaces.safetensors"   # made by `egp train`
    replica = "garage-1"               # unique among the replicas that vehicles can reach
    workers = 4                        # default: one for each core
    queue = 256                        # vehicles that may wait at a time
    http = "127.0.0.1:9464"            # /health, /ready and /metrics; default: none
    log_json = true
    traces = "traces.jsonl"            # spans of requests, for OpenTelemetry; default: none
    [settings.cost]                    # the control step; every field has a default
    lateral = 30.0
    [zenoh]                            # any zenoh setting: its key path and its JSON5 value
    "listen/endpoints" = '["tls/0.0.0.0:7447"]'

Without "listen/endpoints" it listens on tcp/127.0.0.1:7447 only. A service
that other machines reach needs keys, TLS and access control (see `egp keys`):
others could answer in its place, and command the cars.

Vehicles ask on egp/v1/r/REPLICA/FLEET/VEHICLE/step. The service answers its
state on the keys health, ready and metrics of egp/v1/r/REPLICA, and announces
itself by the liveliness token egp/v1/@live/REPLICA. On SIGHUP, or with
--watch when the file changes, it loads and checks the library again beside
the old one. Vehicles that start from then on get the new library; those that
drive keep theirs, which is still served. On SIGTERM it drains: it withdraws
the token, answers the requests that wait, and ends with status 0."#;

/// Answers the control steps of vehicles over zenoh.
#[derive(Parser)]
#[command(version, long_about = HELP)]
#[command(group(ArgGroup::new("served").args(["library", "config"]).required(true).multiple(true)))]
struct Arguments {
    /// Configuration file (TOML).
    #[arg(long)]
    config: Option<PathBuf>,
    /// Library file, made by `egp train`.
    #[arg(long)]
    library: Option<PathBuf>,
    /// SHA-256 of the library; if the file does not hold it, it is fetched from the replicas at --connect, which have 30 s to answer.
    #[arg(long, value_name = "SHA256")]
    fetch: Option<String>,
    /// Name that no other replica has; `main` by default.
    #[arg(long)]
    replica: Option<String>,
    /// Threads that run control steps; one a core by default.
    #[arg(long)]
    workers: Option<usize>,
    /// Endpoint to listen on, such as tcp/0.0.0.0:7447; may be given more than once.
    #[arg(long)]
    listen: Vec<String>,
    /// Endpoint of a router or peer to connect to; may be given more than once.
    #[arg(long)]
    connect: Vec<String>,
    /// Load the library again when its file changes, and not only on SIGHUP.
    #[arg(long)]
    watch: bool,
    /// Address for /health, /ready and /metrics over HTTP, such as 127.0.0.1:9464.
    #[arg(long, value_name = "ADDRESS")]
    http: Option<SocketAddr>,
    /// Log one JSON object a line.
    #[arg(long)]
    log_json: bool,
    /// File to which the spans of requests are appended as JSON lines of OpenTelemetry.
    #[arg(long, value_name = "FILE")]
    traces: Option<PathBuf>,
    /// Check configuration, library and network settings, print what would be served, and end.
    #[arg(long)]
    check: bool,
}

impl Arguments {
    fn configuration(self) -> Result<ServiceConfig, Box<dyn std::error::Error>> {
        let mut config = match (&self.config, &self.library) {
            (Some(path), _) => ServiceConfig::from_file(path)?,
            (None, library) => ServiceConfig::new(library.clone().unwrap_or_default()),
        };
        if let Some(library) = self.library {
            config.library = library;
        }
        if let Some(replica) = self.replica {
            config.replica = replica;
        }
        config.fetch = self.fetch.or(config.fetch);
        config.http = self.http.or(config.http);
        config.workers = self.workers.or(config.workers);
        config.log_json |= self.log_json;
        config.traces = self.traces.or(config.traces);
        if self.watch && config.watch_ms == 0 {
            config.watch_ms = 500;
        }
        for (key, endpoints) in [
            ("listen/endpoints", self.listen),
            ("connect/endpoints", self.connect),
        ] {
            if !endpoints.is_empty() {
                // Rust and JSON5 quote endpoints alike, because those contain no control characters.
                config
                    .zenoh
                    .insert(key.to_owned(), format!("{endpoints:?}"));
            }
        }
        config.validate()?;
        Ok(config)
    }
}

#[allow(unsafe_code)]
fn run() -> Result<(), Box<dyn std::error::Error>> {
    let arguments = Arguments::parse();
    let check = arguments.check;
    let config = arguments.configuration()?;
    // SAFETY: no other thread runs yet.
    unsafe { egp_wire::set_network_threads(egp_service::is_encrypted(&config)) };
    if !check {
        return Ok(serve(&config, ServiceSignals::register()?)?);
    }
    let checked = egp_service::check(&config)?;
    for warning in checked.warnings {
        print_notice(format_args!("egp-server: {warning}"));
    }
    let served = checked.served;
    print_line(format_args!(
        "library {}\nsurfaces: {}\nperiod {} s, horizon {}, window {}",
        hex(&served.library),
        served.members.join(", "),
        served.dt,
        served.horizon,
        served.history
    ))?;
    for other in &served.others {
        print_line(format_args!("further library {}", hex(other)))?;
    }
    Ok(())
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            print_notice(format_args!("egp-server: {error}"));
            ExitCode::FAILURE
        }
    }
}
