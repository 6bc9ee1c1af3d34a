//! The link between one vehicle and one replica.

use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// The time after which a silent link is closed: zenoh's lease of two seconds as the clients configure it, less the time
/// since the last sign of life, which comes every half second.
pub(crate) fn lease(rng: &mut ChaCha8Rng) -> Duration {
    Duration::from_micros(rng.random_range(1_500_000..2_000_000))
}

/// What a link does at present.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Link {
    /// Partitions that are open.
    pub(crate) cut: u32,
    /// Losses of one direction that are open.
    pub(crate) half: u32,
    /// When the last fault of the link ended.
    pub(crate) since: Duration,
    /// The start of the replica's process whose token the vehicle sees; none while it sees none.
    pub(crate) seen: Option<u32>,
}

impl Link {
    pub(crate) fn asks_pass(self) -> bool {
        self.cut == 0
    }

    pub(crate) fn answers_pass(self) -> bool {
        self.cut == 0 && self.half == 0
    }
}

/// The time that a message takes: 0.15 ms and, once in a hundred messages, up to 8 ms more.
pub(crate) fn latency(rng: &mut ChaCha8Rng) -> Duration {
    let tail = if rng.random_range(0..100) == 0 {
        rng.random_range(0..8000)
    } else {
        rng.random_range(0..100)
    };
    Duration::from_micros(150 + tail)
}

/// The time after which a vehicle sees a token appear or go: 1 to 200 ms, as zenoh's connection attempts have it.
pub(crate) fn token_delay(rng: &mut ChaCha8Rng) -> Duration {
    Duration::from_micros(rng.random_range(1000..200_000))
}
