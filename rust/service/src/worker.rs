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
            shared.finish(begun, outcome, &worker.reply, Instant::now());
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
        let hopeless = started + self.metrics.step_time() > job.expected_by();
        // The last request in the queue is tried even if it is likely to be late, because no other request waits for
        // the worker.
        if started > job.deadline || (hopeless && self.queue.len() > 0) {
            let budget = micros(job.deadline - job.arrived);
            self.refuse_job(&job, &self.too_late(budget));
            return None;
        }
        self.metrics.busy.inc();
        Some(Begun { job, started })
    }

    /// Answers with the reply or the error of a step that ended at `ended`.
    pub(crate) fn finish(
        &self,
        begun: Begun<Q>,
        outcome: Result<Status, WireError>,
        reply: &[u8],
        ended: Instant,
    ) {
        let Begun { job, started } = begun;
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
            Err(error) => self.refuse_job(&job, &error),
        }
        self.metrics.busy.dec();
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
        let mut workspace = match self.workspace.take() {
            Some(workspace) => workspace,
            None => handler.workspace()?,
        };
        let (request, reply) = (begun.job.query.payload(), &mut self.reply);
        let step = AssertUnwindSafe(|| {
            let ended = handler.step(&mut workspace, &request, reply);
            (ended, workspace)
        });
        if let Ok((ended, workspace)) = catch_unwind(step) {
            self.workspace = Some(workspace);
            return ended;
        }
        shared.metrics.panicked();
        tracing::error!("a control step panicked; its workspace is replaced");
        let detail = "the control step failed by a defect of the service; please report it";
        Err(WireError::permanent(Code::Internal, detail))
    }
}
