//! What a run is given, and what comes of it.

use crate::fault::ScheduledFault;
use crate::mutant::Mutant;
use crate::oracle::Violation;

/// A run.
#[derive(Clone, Debug)]
pub struct Config {
    /// The seed of all that is random.
    pub seed: u64,
    /// Number of vehicles.
    pub vehicles: usize,
    /// Number of replicas.
    pub replicas: usize,
    /// Number of routers, through which vehicles and replicas reach each other; without one each vehicle has a link to
    /// each replica. At most two.
    pub routers: usize,
    /// Whether the last vehicle drives with the other library, which each replica then serves beside the usual one.
    pub two_libraries: bool,
    /// Virtual duration, s.
    pub seconds: f64,
    /// Whether vehicles and replicas have secret keys.
    pub keys: bool,
    /// Faults in place of those that are drawn from the seed, unless it is empty.
    pub faults: Vec<ScheduledFault>,
    /// Whether the whole trace is kept.
    pub recorded: bool,
    /// A planted fault.
    pub mutant: Option<Mutant>,
}

impl Config {
    /// Three vehicles and three replicas for ten seconds. Odd seeds have secret keys; of five successive seeds three have no
    /// router, one has one and one has two; every third seed has two libraries.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            vehicles: 3,
            replicas: 3,
            routers: match seed % 5 {
                3 => 1,
                4 => 2,
                _ => 0,
            },
            two_libraries: seed % 3 == 2,
            seconds: 10.0,
            keys: !seed.is_multiple_of(2),
            faults: Vec::new(),
            recorded: false,
            mutant: None,
        }
    }
}

/// The result of a run.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Hash of the whole trace.
    pub hash: u64,
    /// The trace, or its end if the run is not recorded.
    pub trace: Vec<String>,
    /// Broken promises, the first of each oracle.
    pub violations: Vec<Violation>,
    /// Control periods.
    pub periods: u64,
    /// Control periods with a usable reply.
    pub replied: u64,
    /// Faults that began.
    pub faults: u64,
}
