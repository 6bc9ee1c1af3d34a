//! Fuzz targets of everything that reads bytes from outside. `cargo test` runs each target for a moment on random edits
//! of valid examples; a longer run and a run under libFuzzer are described in CONTRIBUTING.md.
//!
//! Every target states properties of the values that its decoder accepts, besides that the decoder does not panic.
#![allow(clippy::unwrap_used, clippy::panic)]

mod belief;
mod edits;
mod key;
mod library;
mod message;
mod road;
mod settings;
mod track;

use std::time::Duration;

/// How long `cargo test` runs a target by default. The variable `BOLERO_RANDOM_TEST_TIME_MS` sets another time for all.
const TIME: Duration = Duration::from_millis(400);

/// Calls `judge` with randomly edited examples for `time`.
macro_rules! fuzz {
    ($examples:expr, $words:expr, $judge:expr) => {
        fuzz!($crate::TIME, $examples, $words, $judge)
    };
    ($time:expr, $examples:expr, $words:expr, $judge:expr) => {{
        let (examples, words) = ($examples, $words);
        bolero::check!()
            .with_test_time($time)
            .with_type::<$crate::edits::Edits>()
            .for_each(|edits| $judge(edits.apply(&examples, &words)));
    }};
}
use fuzz;
