//! Faults, drawn from the seed.

use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A fault of one replica, or of the link between a vehicle and a replica.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    /// The process ends; its links close at once. A new one starts when the fault ends.
    Kill(usize),
    /// The process stops and later continues, as by SIGSTOP and SIGCONT.
    Freeze(usize),
    /// Steps take twelve times as long.
    Slow(usize),
    /// Nothing passes between a vehicle and a replica.
    Partition(usize, usize),
    /// Questions of a vehicle reach a replica, and its answers are lost.
    HalfOpen(usize, usize),
    /// The process restarts at once.
    Restart(usize),
    /// The clock of a vehicle jumps forward.
    VehicleClock(usize),
    /// The clock of a replica jumps forward.
    ReplicaClock(usize),
    /// Answers of a replica are cut, replaced by noise, or those of other questions.
    Hostile(usize),
    /// Answers of a replica come twice, or in another order.
    Disorder(usize),
    /// A sender asks a replica a thousand times a second under one name.
    Flood(usize),
    /// The replica restarts with another library until the fault ends.
    Reload(usize),
    /// The replica drains and restarts.
    Drain(usize),
}

/// Draws a fault and its duration.
pub(crate) fn draw(rng: &mut ChaCha8Rng, vehicles: usize, replicas: usize) -> (Fault, Duration) {
    let (v, r) = (rng.random_range(0..vehicles), rng.random_range(0..replicas));
    let fault = match rng.random_range(0..13) {
        0 => Fault::Kill(r),
        1 => Fault::Freeze(r),
        2 => Fault::Slow(r),
        3 => Fault::Partition(v, r),
        4 => Fault::HalfOpen(v, r),
        5 => Fault::Restart(r),
        6 => Fault::VehicleClock(v),
        7 => Fault::ReplicaClock(r),
        8 => Fault::Hostile(r),
        9 => Fault::Disorder(r),
        10 => Fault::Flood(r),
        11 => Fault::Reload(r),
        _ => Fault::Drain(r),
    };
    (
        fault,
        Duration::from_micros(rng.random_range(10_000..3_000_000)),
    )
}
