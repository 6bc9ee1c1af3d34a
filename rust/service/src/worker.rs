//! A worker: takes requests from the queue and answers them.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

use egp_wire::{Code, Status, Timing, WireError};
use prost::Message as _;

use crate::handler::Handler;
use crate::intake::{Job, Shared};
use crate::metrics::micros;

/// Runs until the queue is closed and empty.
pub(crate) fn work<H: Handler>(shared: &Shared, handler: &H, workspace: H::Workspace) {
    let (mut workspace, mut reply) = (Some(workspace), Vec::new());
    while let Some(job) = shared.queue.pop() {
        shared.metrics.busy.inc();
        serve(shared, handler, &mut workspace, &mut reply, &job);
        shared.metrics.busy.dec();
    }
}

fn serve<H: Handler>(
    shared: &Shared,
    handler: &H,
    workspace: &mut Option<H::Workspace>,
    reply: &mut Vec<u8>,
    job: &Job,
) {
    let started = Instant::now();
    let waited = started - job.arrived;
    shared.metrics.waited(waited);
    let hopeless = started + shared.metrics.step_time() > job.expected_by();
    // The last request in the queue is tried even if it is likely to be late, because no other request waits for the
    // worker.
    if started > job.deadline || (hopeless && shared.queue.len() > 0) {
        let budget = micros(job.deadline - job.arrived);
        return shared.refuse(&job.query, &shared.too_late(budget));
    }
    match survive(shared, handler, workspace, &job.query.payload(), reply) {
        Ok(status) => {
            let took = started.elapsed();
            shared.metrics.stepped(took);
            shared.metrics.answered(status);
            let timing = Timing {
                queue_us: micros(waited),
                step_us: micros(took),
                tag: job
                    .sealed
                    .as_ref()
                    .map_or_else(Vec::new, |sealed| sealed.tag(reply)),
            };
            let encoding = "application/protobuf;egp.v1.StepReply";
            let attachment = Some(timing.encode_to_vec());
            job.query
                .answer(job.query.key(), reply.as_slice(), encoding, attachment);
        }
        Err(error) => shared.refuse(&job.query, &error),
    }
}

/// Computes one step. A panic becomes an error, and the workspace, which may be half-written, is replaced.
fn survive<H: Handler>(
    shared: &Shared,
    handler: &H,
    slot: &mut Option<H::Workspace>,
    request: &[u8],
    reply: &mut Vec<u8>,
) -> Result<Status, WireError> {
    let mut workspace = match slot.take() {
        Some(workspace) => workspace,
        None => handler.workspace()?,
    };
    let step = AssertUnwindSafe(|| {
        let ended = handler.step(&mut workspace, request, reply);
        (ended, workspace)
    });
    if let Ok((ended, workspace)) = catch_unwind(step) {
        *slot = Some(workspace);
        return ended;
    }
    shared.metrics.panicked();
    tracing::error!("a control step panicked; its workspace is replaced");
    let detail = "the control step failed by a defect of the service; please report it";
    Err(WireError::permanent(Code::Internal, detail))
}
