//! Structured logs on standard error.

use std::io::IsTerminal as _;

use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// Logs the events that `filter` selects, each line as text or a JSON object. Later calls in a process have no effect.
///
/// # Errors
/// A message that says what is wrong with the filter.
pub fn init_logging(filter: &str, json: bool) -> Result<(), String> {
    let filter = log_filter(filter)?;
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        // A line that cannot be written is lost. The report of that loss would go to standard error, too, and fail with a panic.
        .log_internal_errors(false)
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
    use super::*;

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
}
