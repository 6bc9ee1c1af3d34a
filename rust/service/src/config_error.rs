//! Why a configuration cannot be used.

use egp_core::SettingsError;
use egp_trace::ShareError;
use thiserror::Error;

/// Why a configuration cannot be used.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The text of a file is no configuration.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: String,
        /// What is wrong.
        source: Box<ConfigError>,
    },
    /// Not TOML, an unknown key, or a value of the wrong type; the text quotes the line at fault, or a part of it.
    #[error("the configuration is not valid: {0}")]
    Toml(String),
    /// A number out of range under `[settings]`.
    #[error("[settings] is not valid: {0}")]
    Settings(#[from] SettingsError),
    /// The share of traces is out of range.
    #[error(transparent)]
    Share(#[from] ShareError),
    /// A value out of range.
    #[error("`{field}` must be {expected}, got {got}")]
    Range {
        /// The key.
        field: &'static str,
        /// The accepted range in words.
        expected: &'static str,
        /// The value at fault.
        got: String,
    },
}

impl ConfigError {
    /// The error about a value out of range.
    pub(crate) fn range(field: &'static str, expected: &'static str, got: &dyn ToString) -> Self {
        Self::Range {
            field,
            expected,
            got: got.to_string(),
        }
    }
}

impl From<toml::de::Error> for ConfigError {
    fn from(error: toml::de::Error) -> Self {
        Self::Toml(shortened(&error.to_string()))
    }
}

/// Largest number of characters of a quoted line that are shown.
const SHOWN: usize = 100;
/// Number of these characters that are before the place at fault.
const BEFORE: usize = 40;
/// Largest number of characters of a line of the explanation that are shown. A list of all keys of a section is shorter.
const EXPLAINED: usize = 2000;

/// The text of an error about TOML with its long lines cut. The parser quotes a whole line of the file as `3 | TEXT`, and
/// marks the place at fault by `^` in the line below it.
fn shortened(error: &str) -> String {
    let quote = |line: &str| {
        let bar = line.find('|')?;
        let number = line[..bar].trim();
        let is_quote = number.chars().all(|digit| digit.is_ascii_digit());
        is_quote.then(|| line.chars().take_while(|c| *c != '|').count() + 2)
    };
    let marked = error.lines().find_map(|line| {
        let place = line.chars().position(|c| c == '^')?;
        let text = quote(line)?;
        let empty = line[..line.find('^')?].trim_end().ends_with('|');
        empty.then(|| place.saturating_sub(text))
    });
    let first = match marked {
        Some(place) if place > SHOWN - BEFORE => place - BEFORE,
        _ => 0,
    };
    let cut = |line: &str| match quote(line) {
        Some(text) => {
            let number: String = line.chars().take(text).collect();
            number + &part(line.chars().skip(text + first), SHOWN)
        }
        None => part(line.chars(), EXPLAINED),
    };
    error.lines().map(cut).collect::<Vec<_>>().join("\n")
}

/// The first characters of a line, with dots in place of the rest.
fn part(line: impl Iterator<Item = char>, most: usize) -> String {
    let mut shown: String = line.take(most + 1).collect();
    if let Some((end, _)) = shown.char_indices().nth(most) {
        shown.truncate(end);
        shown.push_str(" ...");
    }
    shown
}

#[cfg(test)]
mod tests {
    use crate::config::ServiceConfig;

    #[test]
    fn a_long_line_is_cut_around_the_place_at_fault() {
        let message = |text: &str| {
            let error = ServiceConfig::from_toml(text).err();
            error.map_or(String::new(), |error| error.to_string())
        };
        let short = message("library = \"a\"\nqueue = true");
        assert!(
            short.contains("2 | queue = true\n  |         ^^^^\ninvalid type"),
            "{short}"
        );
        let long = format!("library = \"{}\" wrong = 1", "ä".repeat(100_000));
        let message = message(&long);
        let lines: Vec<_> = message.lines().collect();
        assert!(
            lines.iter().all(|line| line.chars().count() < 130),
            "{message}"
        );
        let place = |mark: char| {
            let line = lines.iter().find(|line| line.contains(mark));
            line.and_then(|line| line.chars().position(|c| c == mark))
        };
        assert!(message.contains("wrong = 1"), "{message}");
        assert_eq!(place('^'), place('w'), "{message}");
    }

    #[test]
    fn the_end_of_a_long_line_is_left_out() {
        let text = format!("libary = \"{}\"", "a".repeat(100_000));
        let error = ServiceConfig::from_toml(&text).err();
        let message = error.map_or(String::new(), |error| error.to_string());
        assert!(message.len() < 3000, "{message}");
        assert!(message.contains("1 | libary = \"aaaa"), "{message}");
        assert!(message.contains("unknown field `libary`"), "{message}");
    }
}
