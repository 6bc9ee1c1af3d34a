//! Structured logs on standard error.

use std::io::IsTerminal as _;

use tracing_subscriber::EnvFilter;

/// Logs the events that `filter` selects, each line as text or a JSON object. Later calls in a process have no effect.
///
/// # Errors
/// A message that says what is wrong with the filter.
pub fn init_logging(filter: &str, json: bool) -> Result<(), String> {
    let filter = log_filter(filter)?;
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    // A process that has set up its own logging keeps it.
    let _ = if json {
        // The fields of an event stand beside its message, where programs that collect logs look for them.
        subscriber.json().flatten_event(true).try_init()
    } else {
        subscriber.try_init()
    };
    Ok(())
}

/// Reads a filter: a level, or directives.
pub(crate) fn log_filter(filter: &str) -> Result<EnvFilter, String> {
    EnvFilter::try_new(filter).map_err(|error| format!("log filter {filter:?}: {error}"))
}
