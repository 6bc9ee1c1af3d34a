//! A worker: takes requests from the queue and answers them.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use egp_wire::{Code, Status, Timing, WireError};
use prost::Message as _;

use crate::events;
use crate::handler::Handler;
use crate::intake::{Job, Shared};
use crate::metrics::micros;
use crate::query::Query;

/// Runs until the queue is closed and empty.
pub(crate) fn work<H: Handler, Q: Query>(shared: &Shared<Q>, handler: &H, workspace: H::Workspace) {
    let mut worker = Worker::new(workspace);
    while let Some(job) = shared.queue.pop() {
        if let Some(begun) = shared.begin(job, Instant::now()) {
            let outcome = worker.compute(shared, handler, &begun);
            shared.finish(begun, &outcome, &worker.reply, Instant::now());
        }
    }
}

/// A request whose step a worker computes.
pub(crate) struct Begun<Q> {
    job: Job<Q>,
    started: Instant,
}

impl<Q: Query> Shared<Q> {
    /// Begins the step of a request at `started`, or answers with an error if the step would end too late.
    pub(crate) fn begin(&self, job: Job<Q>, started: Instant) -> Option<Begun<Q>> {
        self.metrics.waited(started - job.arrived);
        let next = self.time_to_answer(self.queue.len());
        if next <= (job.deadline - job.arrived) / 4 {
            self.standing.note_short(started);
        }
        let hopeless = started + self.metrics.step_time() > job.expected_by();
        // The last request in the queue is tried even if it is likely to be late, because no other request waits for
        // the worker.
        if started > job.deadline || (hopeless && self.queue.len() > 0) {
            self.refuse_job(&job, &self.too_late(job.budget()));
            return None;
        }
        self.metrics.busy.inc();
        Some(Begun { job, started })
    }

    /// Answers with the reply or the error of a step that ended at `ended`.
    pub(crate) fn finish(
        &self,
        begun: Begun<Q>,
        outcome: &Result<Status, WireError>,
        reply: &[u8],
        ended: Instant,
    ) {
        let Begun { job, started } = begun;
        let outcome = outcome.as_ref().copied();
        // The vehicle may send its next request as soon as it has the answer, and this worker must count as idle by then.
        self.metrics.busy.dec();
        match outcome {
            Ok(status) => {
                let took = ended - started;
                self.metrics.stepped(took);
                self.metrics.answered(status);
                let timing = Timing {
                    queue_us: micros(started - job.arrived),
                    step_us: micros(took),
                    tag: job
                        .sealed
                        .as_ref()
                        .map_or_else(Vec::new, |sealed| sealed.tag(reply)),
                };
                events::answered(job.query.key(), job.sequence, status, &timing);
                let encoding = "application/protobuf;egp.v1.StepReply";
                let attachment = Some(timing.encode_to_vec());
                job.query
                    .answer(job.query.key(), reply.to_vec(), encoding, attachment);
            }
            Err(error) => self.refuse(&job.query, Some(job.sequence), error),
        }
        if let Some(traces) = &self.traces {
            traces.answered(&self.replica, &job, Some(started), ended, outcome);
        }
    }
}

/// The memory of one worker.
pub(crate) struct Worker<W> {
    /// None while a step runs, and after a panic.
    workspace: Option<W>,
    /// Bytes of the last reply.
    pub(crate) reply: Vec<u8>,
}

impl<W> Worker<W> {
    pub(crate) fn new(workspace: W) -> Self {
        Self {
            workspace: Some(workspace),
            reply: Vec::new(),
        }
    }

    /// Computes one step. A panic becomes an error, and the workspace, which may be half-written, is replaced.
    pub(crate) fn compute<H: Handler<Workspace = W>, Q: Query>(
        &mut self,
        shared: &Shared<Q>,
        handler: &H,
        begun: &Begun<Q>,
    ) -> Result<Status, WireError> {
        let (request, reply) = (begun.job.query.payload(), &mut self.reply);
        catch_step(handler, &mut self.workspace, &request, reply, || {
            shared.metrics.panicked();
            tracing::error!("a control step panicked; its workspace is replaced");
        })
    }
}

/// Computes one step in the workspace, or in a new one if there is none. A panic becomes an error, and the workspace, which may
/// be half-written, is removed; `panicked` is called then.
///
/// # Errors
/// [`WireError`] of the step or of a new workspace, and [`Code::Internal`] after a panic.
pub fn catch_step<H: Handler>(
    handler: &H,
    memory: &mut Option<H::Workspace>,
    request: &[u8],
    reply: &mut Vec<u8>,
    panicked: impl FnOnce(),
) -> Result<Status, WireError> {
    let mut workspace = match memory.take() {
        Some(workspace) => workspace,
        None => handler.workspace()?,
    };
    let step = AssertUnwindSafe(|| {
        let ended = handler.step(&mut workspace, request, reply);
        (ended, workspace)
    });
    if let Ok((ended, workspace)) = catch_unwind(step) {
        *memory = Some(workspace);
        return ended;
    }
    panicked();
    let detail = "the control step failed by a defect of the service; please report it";
    Err(WireError::permanent(Code::Internal, detail))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::intake::tests::shared;
    use crate::query::recorded::{Echo, Recorded, Sent, at};

    /// A request that arrived at `start` with a budget of 16 ms; its step should begin after 7 ms at the latest.
    fn taken(
        shared: &Shared<Recorded>,
        start: Instant,
        vehicle: &str,
    ) -> (Recorded, Job<Recorded>) {
        let query = Recorded::request(vehicle, 5, 16_000);
        shared.take(query.clone(), start);
        (query, shared.queue.pop().unwrap())
    }

    /// Whether a step is begun `ms` milliseconds after the request came, while another request waits or none does.
    fn begins(ms: f64, another: bool) -> bool {
        let (shared, start) = (shared(1), Instant::now());
        let (query, job) = taken(&shared, start, "a");
        if another {
            shared.take(Recorded::request("b", 1, 90_000), start);
        }
        let begun = shared.begin(job, at(start, ms)).is_some();
        assert_eq!(shared.metrics.busy_workers(), usize::from(begun));
        let error = query.error();
        assert_eq!(error.is_none(), begun);
        if let Some(error) = error {
            assert_eq!(error.code, Code::TooLate);
            assert!(error.detail.contains("within 16000 us"), "{error}");
        }
        let text = shared.metrics.text(0);
        let waited = format!("egp_queue_seconds_sum {}", ms * 1e-3);
        assert!(text.contains(&waited), "{text}");
        begun
    }

    #[test]
    fn a_step_that_would_end_too_late_makes_room_for_another() {
        assert!(begins(7.0, true));
        assert!(!begins(7.5, true));
    }

    #[test]
    fn the_last_request_is_tried_until_its_deadline() {
        assert!(begins(7.5, false));
        assert!(begins(16.0, false));
        assert!(!begins(16.5, false));
        assert!(!begins(16.5, true));
    }

    #[test]
    fn the_answer_says_how_long_request_and_step_took() {
        let (shared, start) = (shared(1), Instant::now());
        let (handler, mut worker) = (Echo::default(), Worker::new(4));
        let (query, job) = taken(&shared, start, "a");
        let begun = shared.begin(job, at(start, 2.0)).unwrap();
        let outcome = worker.compute(&shared, &handler, &begun);
        assert_eq!(outcome, Ok(Status::IterationLimit));
        shared.finish(begun, &outcome, &worker.reply, at(start, 5.0));
        let timing = Timing {
            queue_us: 2_000,
            step_us: 3_000,
            tag: Vec::new(),
        };
        let answer = Sent::Answer {
            key: query.key.clone(),
            payload: b"4:5".to_vec(),
            timing: Some(timing),
        };
        assert_eq!(query.sent(), Some(answer));
        assert_eq!(shared.metrics.busy_workers(), 0);
        let text = shared.metrics.text(0);
        assert!(text.contains("{outcome=\"iteration_limit\"} 1"), "{text}");
    }

    #[test]
    fn a_panic_is_an_error_and_replaces_the_memory() {
        let (shared, start) = (shared(1), Instant::now());
        let (handler, mut worker) = (Echo::default(), Worker::new(4));
        let bad = Recorded::request("a", Echo::PANICS, 16_000);
        shared.take(bad.clone(), start);
        let begun = shared.begin(shared.queue.pop().unwrap(), start).unwrap();
        let outcome = worker.compute(&shared, &handler, &begun);
        shared.finish(begun, &outcome, &worker.reply, start);
        assert_eq!(bad.code(), Some(Code::Internal));
        assert!(shared.metrics.text(0).contains("egp_panics_total 1"));
        let (_, job) = taken(&shared, start, "a");
        let begun = shared.begin(job, start).unwrap();
        worker.compute(&shared, &handler, &begun).unwrap();
        assert_eq!(worker.reply, b"0:5");
    }

    #[test]
    fn a_worker_serves_what_waits_and_ends_with_the_queue() {
        let shared = shared(1);
        let queries = ["a", "b"].map(|vehicle| {
            let query = Recorded::request(vehicle, 5, 1_000_000);
            // The time of arrival is ahead, so that no answer is late on a machine that is busy.
            shared.take(query.clone(), Instant::now() + Duration::from_secs(3600));
            query
        });
        shared.queue.close();
        work(&shared, &Echo::default(), 4);
        for query in queries {
            assert!(
                matches!(query.sent(), Some(Sent::Answer { payload, .. }) if payload == b"4:5")
            );
        }
    }
}
