//! Faults, drawn from the seed or scheduled.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A fault of one replica, of one router, or of the link between a vehicle and a replica.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The process ends; its links close at once. A new one starts when the fault ends.
    Kill(usize),
    /// The process stops and later continues, as by SIGSTOP and SIGCONT.
    Freeze(usize),
    /// Steps take twelve times as long.
    Slow(usize),
    /// Nothing passes between a vehicle and a replica; with routers, between a vehicle and its routers.
    Partition(usize, usize),
    /// Questions of a vehicle reach a replica, and its answers are lost; with routers, those of all replicas.
    HalfOpen(usize, usize),
    /// The process restarts at once.
    Restart(usize),
    /// The clock of a vehicle jumps forward, as if its program had been held up.
    VehicleClock(usize),
    /// The clock of a replica jumps forward.
    ReplicaClock(usize),
    /// Answers of a replica are cut, replaced by noise, or those of other questions.
    Hostile(usize),
    /// Answers of a replica come twice, or in another order.
    Disorder(usize),
    /// A sender asks a replica a thousand times a second under 64 names.
    Flood(usize),
    /// The replica's library file is replaced and loaded while the replica serves, and again when the fault ends.
    Reload(usize),
    /// The replica restarts with another library until the fault ends.
    OtherLibrary(usize),
    /// The replica drains and restarts.
    Drain(usize),
    /// A router's process ends; its links close at once. A new one starts when the fault ends.
    RouterKill(usize),
    /// A router's process restarts at once.
    RouterRestart(usize),
    /// A router's process stops and later continues.
    RouterFreeze(usize),
}

/// A fault with its time, as `kill:r0@1.5+2`: what, of which replica, when and for how long, s. A fault of a link names
/// the vehicle first, as `partition:car-0:r1@1+0.5`.
#[derive(Clone, Copy, Debug)]
pub struct ScheduledFault {
    pub(crate) fault: Fault,
    pub(crate) begin: Duration,
    pub(crate) length: Duration,
}

impl ScheduledFault {
    /// Whether the vehicle and the router or replica that are named take part in a run of so many.
    pub(crate) fn fits(&self, vehicles: usize, replicas: usize, routers: usize) -> bool {
        match self.fault {
            Fault::Partition(v, r) | Fault::HalfOpen(v, r) => v < vehicles && r < replicas,
            Fault::VehicleClock(v) => v < vehicles,
            Fault::Kill(r)
            | Fault::Freeze(r)
            | Fault::Slow(r)
            | Fault::Restart(r)
            | Fault::ReplicaClock(r)
            | Fault::Hostile(r)
            | Fault::Disorder(r)
            | Fault::Flood(r)
            | Fault::Reload(r)
            | Fault::OtherLibrary(r)
            | Fault::Drain(r) => r < replicas,
            Fault::RouterKill(k) | Fault::RouterRestart(k) | Fault::RouterFreeze(k) => k < routers,
        }
    }
}

/// As [`FromStr`] reads it.
impl fmt::Display for ScheduledFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (begin, length) = (self.begin.as_secs_f64(), self.length.as_secs_f64());
        write!(f, "{}@{begin}+{length}", self.fault)
    }
}

/// What and where, as in a [`ScheduledFault`].
impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kill(r) => write!(f, "kill:r{r}"),
            Self::Freeze(r) => write!(f, "freeze:r{r}"),
            Self::Slow(r) => write!(f, "slow:r{r}"),
            Self::Partition(v, r) => write!(f, "partition:car-{v}:r{r}"),
            Self::HalfOpen(v, r) => write!(f, "half-open:car-{v}:r{r}"),
            Self::Restart(r) => write!(f, "restart:r{r}"),
            Self::VehicleClock(v) => write!(f, "vehicle-clock:car-{v}"),
            Self::ReplicaClock(r) => write!(f, "replica-clock:r{r}"),
            Self::Hostile(r) => write!(f, "hostile:r{r}"),
            Self::Disorder(r) => write!(f, "disorder:r{r}"),
            Self::Flood(r) => write!(f, "flood:r{r}"),
            Self::Reload(r) => write!(f, "reload:r{r}"),
            Self::OtherLibrary(r) => write!(f, "other-library:r{r}"),
            Self::Drain(r) => write!(f, "drain:r{r}"),
            Self::RouterKill(k) => write!(f, "router-kill:router-{k}"),
            Self::RouterRestart(k) => write!(f, "router-restart:router-{k}"),
            Self::RouterFreeze(k) => write!(f, "router-freeze:router-{k}"),
        }
    }
}

impl FromStr for ScheduledFault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let seconds = |text: &str| Duration::try_from_secs_f64(text.parse().ok()?).ok();
        let parsed = text.split_once('@').and_then(|(fault, times)| {
            let (begin, length) = times.split_once('+')?;
            Some(Self {
                fault: fault_of(fault)?,
                begin: seconds(begin)?,
                length: seconds(length)?,
            })
        });
        parsed.ok_or_else(|| {
            format!("expected WHAT:WHERE@BEGIN+LENGTH, such as kill:r0@1.5+2, got {text}")
        })
    }
}

fn fault_of(text: &str) -> Option<Fault> {
    let replica = |text: &str| text.strip_prefix('r')?.parse().ok();
    let router = |text: &str| text.strip_prefix("router-")?.parse().ok();
    let vehicle = |text: &str| text.strip_prefix("car-")?.parse().ok();
    let link = |text: &str| {
        let (v, r) = text.split_once(':')?;
        Some((vehicle(v)?, replica(r)?))
    };
    let (what, place) = text.split_once(':')?;
    match what {
        "kill" => replica(place).map(Fault::Kill),
        "freeze" => replica(place).map(Fault::Freeze),
        "slow" => replica(place).map(Fault::Slow),
        "partition" => link(place).map(|(v, r)| Fault::Partition(v, r)),
        "half-open" => link(place).map(|(v, r)| Fault::HalfOpen(v, r)),
        "restart" => replica(place).map(Fault::Restart),
        "vehicle-clock" => vehicle(place).map(Fault::VehicleClock),
        "replica-clock" => replica(place).map(Fault::ReplicaClock),
        "hostile" => replica(place).map(Fault::Hostile),
        "disorder" => replica(place).map(Fault::Disorder),
        "flood" => replica(place).map(Fault::Flood),
        "reload" => replica(place).map(Fault::Reload),
        "other-library" => replica(place).map(Fault::OtherLibrary),
        "drain" => replica(place).map(Fault::Drain),
        "router-kill" => router(place).map(Fault::RouterKill),
        "router-restart" => router(place).map(Fault::RouterRestart),
        "router-freeze" => router(place).map(Fault::RouterFreeze),
        _ => None,
    }
}

/// Draws a fault and its duration. In runs with routers one fault in four is a router's.
pub(crate) fn draw(
    rng: &mut ChaCha8Rng,
    vehicles: usize,
    replicas: usize,
    routers: usize,
) -> (Fault, Duration) {
    let (v, r) = (rng.random_range(0..vehicles), rng.random_range(0..replicas));
    let length = Duration::from_micros(rng.random_range(10_000..3_000_000));
    if routers > 0 && rng.random_range(0..4) == 0 {
        let k = rng.random_range(0..routers);
        let fault = match rng.random_range(0..3) {
            0 => Fault::RouterKill(k),
            1 => Fault::RouterRestart(k),
            _ => Fault::RouterFreeze(k),
        };
        return (fault, length);
    }
    let fault = match rng.random_range(0..15) {
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
        11 | 12 => Fault::Reload(r),
        13 => Fault::OtherLibrary(r),
        _ => Fault::Drain(r),
    };
    (fault, length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scheduled_fault_is_written_as_it_is_read() {
        for text in [
            "kill:r9@1+2",
            "freeze:r0@1.5+0.25",
            "slow:r1@0+1",
            "partition:car-0:r1@1+0.5",
            "half-open:car-2:r0@1+0.5",
            "restart:r0@1+0",
            "vehicle-clock:car-0@1+0",
            "replica-clock:r0@1+0",
            "hostile:r0@1+2",
            "disorder:r0@1+2",
            "flood:r0@1+2",
            "reload:r0@1+2",
            "other-library:r0@1+2",
            "drain:r0@1+2",
            "router-kill:router-0@1+2",
            "router-restart:router-1@1+0",
            "router-freeze:router-1@1+2",
        ] {
            let written = text
                .parse::<ScheduledFault>()
                .map(|fault| fault.to_string());
            assert_eq!(written.as_deref(), Ok(text));
        }
    }
}
