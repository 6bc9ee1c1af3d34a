//! Structured logs on standard error.

use std::fs::File;
use std::io::{self, IsTerminal as _};
use std::os::fd::AsFd as _;
use std::sync::OnceLock;
use std::time::Duration;

use prometheus_client::registry::Registry;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

use crate::log_writer::LogWriter;

/// How long the end of a process waits for its last lines.
const PATIENCE: Duration = Duration::from_secs(1);

/// What writes the log of this process.
static WRITER: OnceLock<LogWriter> = OnceLock::new();

/// Shows in a metric how many lines of the log could not be written or had no room.
pub(crate) fn show_lost(registry: &mut Registry) {
    let lost = WRITER.get().map(LogWriter::lost).unwrap_or_default();
    let help = "Lines of the log that could not be written, or that were not read in time";
    registry.register("log_lines_lost", help, lost);
}

/// Lets the lines of the log be written when it is dropped, for a second at most.
pub(crate) struct FlushAtEnd;

impl Drop for FlushAtEnd {
    fn drop(&mut self) {
        if let Some(writer) = WRITER.get() {
            writer.flush(PATIENCE);
        }
    }
}

/// Logs the events that `filter` selects, each line as text or a JSON object. Later calls in a process have no effect.
///
/// Nothing waits for the program that reads the log: a line that it has no room for is lost, and counted.
///
/// # Errors
/// A message that says what is wrong with the filter, or why the thread that writes cannot be started.
pub fn init_logging(filter: &str, json: bool) -> Result<(), String> {
    let filter = log_filter(filter)?;
    let writer = if let Some(writer) = WRITER.get() {
        writer
    } else {
        let new = writer().map_err(|error| format!("cannot start the log: {error}"))?;
        WRITER.get_or_init(|| new)
    };
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(io::stderr().is_terminal())
        // The report of a line that is lost would go to standard error, too, and fail with a panic.
        .log_internal_errors(false)
        .with_writer(writer.clone());
    // A process that has set up its own logging keeps it.
    let _ = if json {
        // The fields of an event stand beside its message, where programs that collect logs look for them.
        subscriber.json().flatten_event(true).try_init()
    } else {
        subscriber.try_init()
    };
    Ok(())
}

/// A writer to standard error. It has a descriptor of its own, because one that waits must not hold the lock of
/// [`io::stderr`], which reports of panics take.
fn writer() -> io::Result<LogWriter> {
    match io::stderr().as_fd().try_clone_to_owned() {
        Ok(output) => LogWriter::start(File::from(output)),
        // Standard error is closed.
        Err(_) => LogWriter::start(io::sink()),
    }
}

/// Reads a filter: a level, or directives. A word that is no level would be taken for the name of a target, and all logs of
/// others would be off.
///
/// # Errors
/// A message that says what is wrong with the filter.
pub(crate) fn log_filter(filter: &str) -> Result<EnvFilter, String> {
    let wrong = |reason: &str| {
        format!(
            "log filter {filter:?}: {reason}; expected off, error, warn, info, debug or trace, or directives such as \
             info,zenoh=warn"
        )
    };
    let directives: Vec<_> = filter.split(',').map(str::trim).collect();
    if directives.iter().all(|text| text.is_empty()) {
        return Err(wrong("it is empty"));
    }
    let known = |text: &str| {
        text.is_empty() || text.contains(['=', '[']) || text.parse::<LevelFilter>().is_ok()
    };
    if let Some(word) = directives.into_iter().find(|text| !known(text)) {
        return Err(wrong(&format!("{word:?} is no level")));
    }
    EnvFilter::try_new(filter).map_err(|error| wrong(&error.to_string()))
}

#[cfg(test)]
mod tests {
    use tracing::Level;

    use super::*;
    use crate::config::ServiceConfig;
    use crate::map::MapConfig;

    #[test]
    fn a_word_that_is_no_level_is_an_error() {
        for filter in [
            "verbose",
            "warning",
            "",
            " ",
            ",",
            "info,zenoh",
            "6",
            "zenoh=verbose",
        ] {
            let error = log_filter(filter).err().unwrap_or_default();
            assert!(
                error.contains("expected off, error, warn"),
                "{filter}: {error}"
            );
        }
        for filter in [
            "info,zenoh=warn",
            "WARN",
            "Off",
            "3",
            "egp_service=debug",
            "info,zenoh=warn,",
            "warn,[request]=debug",
            "warn,[request]",
        ] {
            assert!(log_filter(filter).is_ok(), "{filter}");
        }
    }

    #[test]
    fn the_default_filters_leave_out_what_zenoh_says_of_each_stranger() {
        for filter in [ServiceConfig::new("").log, MapConfig::default().log] {
            let subscriber = tracing_subscriber::fmt()
                .with_env_filter(log_filter(&filter).unwrap_or_default())
                .finish();
            tracing::subscriber::with_default(subscriber, || {
                assert!(!tracing::enabled!(target: "zenoh_link_tls::unicast", Level::WARN));
                assert!(tracing::enabled!(target: "zenoh_link_tls::unicast", Level::ERROR));
                // A query whose sender chose a short timeout.
                assert!(
                    !tracing::enabled!(target: "zenoh::net::routing::dispatcher::queries", Level::WARN)
                );
                // An attempt to connect to a router that does not run yet, several times a second.
                assert!(
                    !tracing::enabled!(target: "zenoh::net::runtime::orchestrator", Level::WARN)
                );
                assert!(tracing::enabled!(target: "zenoh_transport::manager", Level::WARN));
                assert!(tracing::enabled!(target: "egp_service::server", Level::INFO));
            });
        }
    }
}
