//! A real service and real clients over TCP on the loopback.
#![allow(clippy::unwrap_used, clippy::expect_used, dead_code)]

use std::path::PathBuf;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use egp_core::{Kernel, Library, Settings};
use egp_driver::Carry;
use egp_engine::{Engine, EngineWorkspace};
use egp_service::{Handler, ServiceConfig};
use egp_testing::libraries;
pub use egp_testing::ports::free_endpoint;
use egp_wire::{Header, LibraryId, Ready, Request, Status, Timing, WireError, keys};
use prost::Message as _;
use zenoh::Wait;

pub const BUDGET_US: u32 = 5_000_000;

/// Bytes of a small library of two surfaces.
pub fn library_bytes() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| {
        let spec = libraries::spec(Kernel::Rbf, &[0.5, 1.1], 80, 3);
        egp_core::library::encode(&spec).unwrap()
    })
}

/// The same library as a file.
pub fn library_file(name: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, library_bytes()).unwrap();
    path
}

pub fn engine() -> Engine {
    let library = Library::from_bytes(library_bytes()).unwrap();
    let settings = Settings {
        horizon: Some(20),
        ..Settings::default()
    };
    Engine::new(library, settings).unwrap()
}

pub fn library_id() -> LibraryId {
    engine().library().id()
}

/// An engine that calls a function with the sequence number of each request before its step.
pub struct Watched<F> {
    pub engine: Engine,
    pub before: F,
}

impl<F: Fn(u64) + Send + Sync + 'static> Handler for Watched<F> {
    type Workspace = EngineWorkspace;

    fn describe(&self) -> Ready {
        self.engine.describe()
    }

    fn workspace(&self) -> Result<EngineWorkspace, WireError> {
        self.engine.workspace()
    }

    fn step(
        &self,
        workspace: &mut EngineWorkspace,
        request: &[u8],
        reply: &mut Vec<u8>,
    ) -> Result<Status, WireError> {
        (self.before)(Header::decode(request)?.sequence);
        self.engine.step(workspace, request, reply)
    }
}

pub fn config(endpoint: &str) -> ServiceConfig {
    let mut config = ServiceConfig::new("unused");
    config.workers = Some(2);
    config.load_ms = 50;
    config
        .zenoh
        .insert("listen/endpoints".to_owned(), format!("[\"{endpoint}\"]"));
    config
}

/// A vehicle's network connection.
pub struct Client {
    pub session: zenoh::Session,
}

/// The answer to a query.
#[derive(Debug, PartialEq)]
pub enum Outcome {
    Answer {
        payload: Vec<u8>,
        timing: Option<Timing>,
    },
    Error(WireError),
    Empty,
}

impl Client {
    /// Connects and waits until the replica `main` is alive.
    pub fn connect(endpoint: &str) -> Self {
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("connect/endpoints", format!("[\"{endpoint}\"]")),
            (
                "connect/retry",
                "{ period_init_ms: 20, period_max_ms: 50 }".to_owned(),
            ),
            ("listen/endpoints", "[]".to_owned()),
            ("scouting/multicast/enabled", "false".to_owned()),
        ] {
            config.insert_json5(key, &value).unwrap();
        }
        let client = Self {
            session: zenoh::open(config).wait().unwrap(),
        };
        client.wait_until_alive(true);
        client
    }

    pub fn is_alive(&self) -> bool {
        let tokens = self
            .session
            .liveliness()
            .get(keys::ALL_LIVE)
            .wait()
            .unwrap();
        tokens.recv().is_ok()
    }

    pub fn wait_until_alive(&self, alive: bool) {
        let deadline = Instant::now() + Duration::from_secs(20);
        while self.is_alive() != alive {
            assert!(
                Instant::now() < deadline,
                "the replica did not become alive = {alive}"
            );
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    pub fn ask(&self, key: &str, payload: &[u8]) -> Outcome {
        self.start(key, payload)()
    }

    /// Sends a query; the function returned waits for the answer.
    pub fn start(&self, key: &str, payload: &[u8]) -> impl FnOnce() -> Outcome + use<> {
        let replies = self
            .session
            .get(key)
            .payload(payload.to_vec())
            .wait()
            .unwrap();
        move || match replies.recv() {
            Err(_) => Outcome::Empty,
            Ok(reply) => match reply.into_result() {
                Ok(sample) => Outcome::Answer {
                    timing: sample
                        .attachment()
                        .map(|a| Timing::decode(&*a.to_bytes()).unwrap()),
                    payload: sample.payload().to_bytes().into_owned(),
                },
                Err(error) => {
                    Outcome::Error(WireError::decode(&error.payload().to_bytes()).unwrap())
                }
            },
        }
    }
}

pub fn step_key(vehicle: &str) -> String {
    let name = |text: &str| text.parse().unwrap();
    keys::step(&name("main"), &name("fleet"), &name(vehicle))
}

/// The next request of a vehicle on a left-hand circle of 60 m radius at 14 m/s.
pub fn request(carry: &mut Carry) -> Request {
    let (radius, speed, dt) = (60.0, 14.0, 0.05);
    let reference = (0..=20).map(|t| {
        let angle = speed * dt * f64::from(t) / radius;
        [
            radius * angle.sin(),
            radius * (1.0 - angle.cos()),
            speed,
            angle,
        ]
    });
    let x = [0.1, -0.5, 13.0, 0.05, 0.02, 0.1, 0.03];
    let request = carry.request(x, reference.collect(), vec![[3.0, 3.0]; 21], BUDGET_US);
    carry.applied([300.0, 0.05]);
    request
}

/// A first request.
pub fn first_request() -> Request {
    request(&mut Carry::new(library_id(), 10))
}
