//! Structured logs on standard error.

use std::io::IsTerminal as _;

use tracing_subscriber::EnvFilter;

/// Logs what `filter` lets through, as text or one JSON object a line. The first call in a process wins.
///
/// # Errors
/// What is wrong with the filter.
pub fn init_logging(filter: &str, json: bool) -> Result<(), String> {
    let filter =
        EnvFilter::try_new(filter).map_err(|error| format!("log filter {filter:?}: {error}"))?;
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    // A host that has set its own logging up keeps it.
    let _ = if json {
        subscriber.json().try_init()
    } else {
        subscriber.try_init()
    };
    Ok(())
}
