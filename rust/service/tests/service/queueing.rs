//! Which requests wait, are displaced, or get an error, while the worker is held up on purpose.
#![allow(clippy::unwrap_used, clippy::panic, missing_docs)]

use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

use crate::loopback::{
    Client, Outcome, Watched, config, engine, first_request, free_endpoint, step_key,
};
use egp_service::{Server, ServiceConfig};
use egp_wire::{Code, Reply, WireError};

const PATIENCE: Duration = Duration::from_secs(60);

struct Setup {
    // This field is dropped first, so that a failing test releases the worker before the server waits for it.
    leave: Sender<()>,
    server: Server,
    client: Client,
    begun: Receiver<u64>,
}

fn setup(change: impl FnOnce(&mut ServiceConfig)) -> Setup {
    let endpoint = free_endpoint();
    let mut config = config(&endpoint);
    config.workers = Some(1);
    change(&mut config);
    let (begun_in, begun) = channel();
    let (leave, leave_out) = channel();
    let leave_out = Mutex::new(leave_out);
    // The engine reports when it begins a step, and then waits for permission.
    let held = Watched {
        engine: engine(),
        before: move |sequence| {
            begun_in.send(sequence).unwrap();
            leave_out.lock().unwrap().recv().unwrap();
        },
    };
    let server = Server::start_with(&config, held).unwrap();
    Setup {
        server,
        client: Client::connect(&endpoint),
        begun,
        leave,
    }
}

impl Setup {
    /// Sends a request with this sequence number and budget.
    fn send(
        &self,
        vehicle: &str,
        sequence: u64,
        budget_ms: u32,
    ) -> impl FnOnce() -> Outcome + use<> {
        let mut request = first_request();
        (request.sequence, request.budget_us) = (sequence, budget_ms * 1000);
        self.client.start(&step_key(vehicle), &request.encode())
    }
}

fn sequence(outcome: &Outcome) -> u64 {
    match outcome {
        Outcome::Answer { payload, .. } => Reply::decode(payload).unwrap().sequence,
        other => panic!("{other:?}"),
    }
}

fn code(outcome: &Outcome) -> Code {
    match outcome {
        Outcome::Error(error) => error.code,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_newest_request_of_a_vehicle_supersedes_the_waiting_one() {
    let setup = setup(|_| {});
    let first = setup.send("a", 1, 9000);
    assert_eq!(setup.begun.recv_timeout(PATIENCE).unwrap(), 1);
    let second = setup.send("a", 2, 9000);
    let third = setup.send("a", 3, 9000);
    assert_eq!(code(&second()), Code::Superseded);
    setup.leave.send(()).unwrap();
    setup.leave.send(()).unwrap();
    assert_eq!((sequence(&first()), sequence(&third())), (1, 3));
    setup.server.drain();
}

#[test]
fn a_flooding_vehicle_does_not_starve_the_others_and_the_earliest_deadline_goes_first() {
    let setup = setup(|_| {});
    let first = setup.send("flood", 1, 9000);
    assert_eq!(setup.begun.recv_timeout(PATIENCE).unwrap(), 1);
    let flood: Vec<_> = (2..50).map(|n| setup.send("flood", n, 9000)).collect();
    let patient = setup.send("patient", 100, 8000);
    let hurried = setup.send("hurried", 200, 7000);
    // Replaced requests are answered at once, so all but perhaps the last two have arrived by then.
    let mut outcomes: Vec<_> = flood.into_iter().map(std::thread::spawn).collect();
    let newest = outcomes.pop().unwrap();
    for outcome in outcomes {
        assert_eq!(code(&outcome.join().unwrap()), Code::Superseded);
    }
    let deadline = Instant::now() + Duration::from_secs(5);
    let metrics = || match setup.client.ask("egp/v1/r/main/metrics", &[]) {
        Outcome::Answer { payload, .. } => String::from_utf8(payload).unwrap(),
        other => panic!("{other:?}"),
    };
    while !metrics().contains("egp_queued 3") {
        assert!(Instant::now() < deadline, "{}", metrics());
    }
    for _ in 0..4 {
        setup.leave.send(()).unwrap();
    }
    let order: Vec<u64> = setup.begun.iter().take(3).collect();
    assert_eq!(order, [200, 100, 49]);
    for (wait, expected) in [
        (sequence(&first()), 1),
        (sequence(&patient()), 100),
        (sequence(&hurried()), 200),
    ] {
        assert_eq!(wait, expected);
    }
    assert_eq!(sequence(&newest.join().unwrap()), 49);
    setup.server.drain();
}

#[test]
fn a_full_queue_is_overloaded_and_a_spent_budget_too_late() {
    let setup = setup(|config| config.queue = 1);
    let first = setup.send("a", 1, 9000);
    assert_eq!(setup.begun.recv_timeout(PATIENCE).unwrap(), 1);
    let waiting = setup.send("b", 2, 1);
    let refused = setup.send("c", 3, 9000)();
    assert_eq!(code(&refused), Code::Overloaded);
    assert!(matches!(
        refused,
        Outcome::Error(WireError {
            retryable: true,
            ..
        })
    ));
    std::thread::sleep(Duration::from_millis(5));
    setup.leave.send(()).unwrap();
    assert_eq!(sequence(&first()), 1);
    assert_eq!(code(&waiting()), Code::TooLate);
    setup.server.drain();
}

#[test]
fn a_service_that_was_slow_once_does_not_refuse_for_ever() {
    let setup = setup(|_| {});
    let slow = setup.send("a", 1, 9000);
    assert_eq!(setup.begun.recv_timeout(PATIENCE).unwrap(), 1);
    std::thread::sleep(Duration::from_secs(2));
    setup.leave.send(()).unwrap();
    assert_eq!(sequence(&slow()), 1);
    // The budget is shorter than the 2 s by which a step is now estimated.
    let wait = setup.send("a", 2, 1500);
    assert_eq!(setup.begun.recv_timeout(PATIENCE).unwrap(), 2);
    setup.leave.send(()).unwrap();
    assert_eq!(sequence(&wait()), 2);
    setup.server.drain();
}
