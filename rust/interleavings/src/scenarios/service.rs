//! Intake, queue and workers of a service, with vehicles that ask at the same time.

use std::time::Duration;

use egp_testing::messages;
use egp_wire::{Code, Header, KeyRing, Ready, Seal, Status, WireError};

use crate::guard::Guard;
use crate::handler::Handler;
use crate::intake::Shared;
use crate::metrics::Metrics;
use crate::offer::Offer;
use crate::question::{Answer, Question, name, request, step_key};
use crate::queue::Queue;
use crate::standing::Standing;
use crate::sync::atomic::{AtomicBool, Ordering};
use crate::sync::mpsc::Receiver;
use crate::sync::thread::JoinHandle;
use crate::sync::{Arc, thread};
use crate::worker::work;

const WORKERS: usize = 2;

/// Replies with the request's sequence number.
struct Echo;

impl Handler for Echo {
    type Workspace = ();

    fn describe(&self) -> Ready {
        messages::ready()
    }

    fn workspace(&self) -> Result<(), WireError> {
        Ok(())
    }

    fn step(&self, (): &mut (), request: &[u8], reply: &mut Vec<u8>) -> Result<Status, WireError> {
        let header = Header::decode(request)?;
        // Other threads may run during a step.
        thread::yield_now();
        *reply = echo(header.sequence);
        Ok(Status::Solved)
    }
}

fn echo(sequence: u64) -> Vec<u8> {
    sequence.to_le_bytes().to_vec()
}

/// Whether the queue is about to be closed, and whether it was. These are none of shuttle's, so that they add no
/// interleavings.
#[derive(Default)]
struct Closing(std::sync::atomic::AtomicBool, std::sync::atomic::AtomicBool);

impl Closing {
    fn begun(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn ended(&self) -> bool {
        self.1.load(Ordering::Relaxed)
    }
}

/// A service without network.
struct Service {
    closing: Arc<Closing>,
    shared: Arc<Shared<Question>>,
    workers: Vec<JoinHandle<()>>,
}

impl Service {
    fn start(guard: Option<Guard>) -> Self {
        let metrics = Metrics::new(&[], WORKERS);
        // The estimate follows slowly from here, so no request is expected to be late on a machine that is busy.
        metrics.stepped(Duration::from_micros(1));
        let shared = Arc::new(Shared {
            replica: name("main"),
            metrics,
            describe: Box::new(messages::ready),
            workers: WORKERS,
            queue: Queue::new(3),
            standing: Standing::default(),
            draining: AtomicBool::new(false),
            guard,
            traces: None,
            offer: Offer::none(),
        });
        let workers = (0..WORKERS).map(|_| {
            let shared = shared.clone();
            thread::spawn(move || work(&shared, &Echo, ()))
        });
        Self {
            closing: Arc::default(),
            workers: workers.collect(),
            shared,
        }
    }

    /// Closes the queue as a service does that drains, and waits for the workers.
    fn stop(self) {
        self.shared.draining.store(true, Ordering::Relaxed);
        self.closing.0.store(true, Ordering::Relaxed);
        self.shared.queue.close();
        self.closing.1.store(true, Ordering::Relaxed);
        for worker in self.workers {
            worker.join().unwrap();
        }
        assert_eq!(self.shared.queue.len(), 0);
        assert_eq!(self.shared.metrics.busy_workers(), 0);
    }
}

/// Asks for a vehicle; the answer comes later.
fn ask(shared: &Shared<Question>, vehicle: &str, sequence: u64) -> Receiver<Answer> {
    let (question, answer) = Question::new(vehicle, request(sequence), Vec::new());
    question.ask(shared);
    answer
}

/// Three vehicles ask twice each without waiting in between, and then wait for both answers: the second question gets its
/// reply, and the first one its own or the error that the second one took its place.
pub fn each_request_gets_its_answer() {
    let service = Service::start(None);
    let vehicles: Vec<_> = ["a", "b", "c"]
        .into_iter()
        .zip(0..)
        .map(|(vehicle, index)| {
            let shared = service.shared.clone();
            thread::spawn(move || {
                let (first, second) = (10 * index, 10 * index + 1);
                let answers = [first, second].map(|number| ask(&shared, vehicle, number));
                let [older, newer] = answers.map(|answer| answer.recv().unwrap());
                assert!(older == Ok(echo(first)) || older == Err(Code::Superseded));
                assert_eq!(newer, Ok(echo(second)));
            })
        })
        .collect();
    for vehicle in vehicles {
        vehicle.join().unwrap();
    }
    service.stop();
}

/// Two vehicles ask while the service drains. What was taken before the queue is closed gets its reply, what comes
/// afterwards gets the error that says so, and the workers end.
pub fn a_service_that_drains_answers_everything() {
    let service = Service::start(None);
    let vehicles: Vec<_> = ["a", "b"]
        .into_iter()
        .map(|vehicle| {
            let (shared, closing) = (service.shared.clone(), service.closing.clone());
            thread::spawn(move || {
                for sequence in 0..3 {
                    let late = closing.ended();
                    let answer = ask(&shared, vehicle, sequence);
                    let early = !closing.begun();
                    let answer = answer.recv().unwrap();
                    assert!(
                        answer == Ok(echo(sequence)) && !late
                            || answer == Err(Code::Draining) && !early
                    );
                }
            })
        })
        .collect();
    service.stop();
    for vehicle in vehicles {
        vehicle.join().unwrap();
    }
}

/// Two copies of one sealed request come at the same time, as over two links: one gets the reply, the other an error.
pub fn a_sealed_request_counts_once() {
    let ring = KeyRing::parse(&format!("fleet/a {}", "a1".repeat(32))).unwrap();
    let key = ring.get(&name("fleet"), &name("a")).unwrap().clone();
    let service = Service::start(Some(Guard::new(ring)));
    let ask = move |shared: &Shared<Question>, number: u64| {
        let (run, payload) = (1, request(number));
        let tag = key.question(&step_key("a"), run, number, &payload);
        let vehicle = (name("fleet"), name("a"));
        let seal = Seal {
            vehicle,
            run,
            number,
            tag,
        };
        let (question, answer) = Question::new("a", payload, seal.encode());
        question.ask(shared);
        answer.recv().unwrap()
    };
    // The run is known when the copies come.
    assert_eq!(ask(&service.shared, 1), Ok(echo(1)));
    let copies: Vec<_> = (0..2)
        .map(|_| {
            let (shared, ask) = (service.shared.clone(), ask.clone());
            thread::spawn(move || ask(&shared, 2))
        })
        .collect();
    let mut answers: Vec<_> = copies
        .into_iter()
        .map(|copy| copy.join().unwrap())
        .collect();
    answers.sort();
    assert_eq!(answers, [Ok(echo(2)), Err(Code::Unauthenticated)]);
    service.stop();
}
