//! The vehicle's spans of a control step, which `docs/deploying.md`, section 3, describes.

use std::path::Path;

use egp_driver::{Outcome, Query, QueryId, Step, Time};
use egp_trace::{
    Counts, Kind, Moment, Resource, Share, ShareError, Span, StepIds, TraceError, TraceFile, name,
};
use egp_wire::keys::Name;
use egp_wire::{Header, WireError};
use thiserror::Error;

/// Why the spans of a vehicle cannot be written.
#[derive(Debug, Error)]
pub enum StepTracesError {
    /// The share is out of range.
    #[error(transparent)]
    Share(#[from] ShareError),
    /// The file cannot be written.
    #[error(transparent)]
    File(#[from] TraceError),
}

/// Collects what happens to the questions of one control period after the other, and writes the periods' spans. A transport
/// passes it the same events as its driver, with the times of the driver's clock.
pub struct StepTraces {
    file: TraceFile,
    share: Share,
    fleet: Name,
    vehicle: Name,
    asked: Vec<Asked>,
}

/// A question of the period that is open.
struct Asked {
    id: QueryId,
    replica: Name,
    sent: Time,
    answer: Option<(Time, Answer)>,
}

/// How a question ended.
enum Answer {
    Reply,
    Error(Box<WireError>),
    /// Nothing was answered, or no error that can be read.
    Nothing,
}

impl StepTraces {
    /// Opens the file to which the spans of this vehicle are appended; `share` is the share of the traces that is written.
    ///
    /// # Errors
    /// [`StepTracesError`] if the share is out of range or the file cannot be opened for writing.
    pub fn open(
        path: &Path,
        share: f64,
        fleet: &Name,
        vehicle: &Name,
    ) -> Result<Self, StepTracesError> {
        let resource = Resource {
            service: "egp-vehicle",
            instance: format!("{fleet}/{vehicle}"),
        };
        Ok(Self {
            share: Share::new(share)?,
            file: TraceFile::open(path, resource)?,
            fleet: fleet.clone(),
            vehicle: vehicle.clone(),
            asked: Vec::new(),
        })
    }

    /// What became of the spans so far.
    pub fn counts(&self) -> Counts {
        self.file.counts()
    }

    /// A replica is asked for the open period's step.
    pub fn asked(&mut self, at: Time, query: &Query) {
        self.asked.push(Asked {
            id: query.id,
            replica: query.replica.clone(),
            sent: at,
            answer: None,
        });
    }

    /// A replica replied.
    pub fn replied(&mut self, at: Time, id: QueryId) {
        self.answered(at, id, || Answer::Reply);
    }

    /// A replica answered with an error, given as the bytes of an `egp.v1.Error`.
    pub fn refused(&mut self, at: Time, id: QueryId, error: &[u8]) {
        self.answered(at, id, || match WireError::decode(error) {
            Ok(error) => Answer::Error(Box::new(error)),
            Err(_) => Answer::Nothing,
        });
    }

    /// A query ended. Without effect if an answer came before.
    pub fn ended(&mut self, at: Time, id: QueryId) {
        self.answered(at, id, || Answer::Nothing);
    }

    /// Gives up the open period, which has no command. No span is written for its questions, also not with a later period.
    pub fn abandon(&mut self) {
        self.asked.clear();
    }

    /// Notes the first answer to a question of the open period.
    fn answered(&mut self, at: Time, id: QueryId, answer: impl FnOnce() -> Answer) {
        let open = |asked: &&mut Asked| asked.id == id && asked.answer.is_none();
        if let Some(asked) = self.asked.iter_mut().find(open) {
            asked.answer = Some((at, answer()));
        }
    }

    /// A control period that began at `began` was decided at `decided`; `clock` gives the present time. Writes its spans, if
    /// its trace is among the share. A period without a request has no trace.
    pub fn decided(&mut self, began: Time, decided: Time, step: &Step, clock: impl Fn() -> Time) {
        let asked = std::mem::take(&mut self.asked);
        let Ok(header) = Header::decode(&step.request) else {
            return;
        };
        let (fleet, vehicle) = (self.fleet.as_str(), self.vehicle.as_str());
        let ids = StepIds::new(fleet, vehicle, &step.request);
        if !self.share.contains(ids.trace()) {
            return;
        }
        let moment = Moment::now(clock);
        let mut spans: Vec<Span> = (asked.into_iter())
            .map(|asked| asked.span(&ids, &moment, decided))
            .collect();
        let times = moment.unix_ns(began)..moment.unix_ns(decided);
        let mut whole = Span::new(&ids, name::STEP, Kind::Internal, times)
            .with("egp.fleet", fleet)
            .with("egp.vehicle", vehicle)
            .with("egp.sequence", header.sequence)
            .with("egp.library", &header.library)
            .with("egp.outcome", step.outcome.name())
            .with("egp.mode", step.command.mode.name());
        if let Some(replica) = &step.replica {
            whole = whole.with("egp.replica", replica.as_str());
        }
        if let Outcome::Refused(error) = &step.outcome {
            whole = whole.with("egp.error_code", error.code_name());
        }
        if !step.late.is_empty() {
            whole = whole.with("egp.late_replies", step.late.len() as u64);
        }
        if !step.outcome.is_solved() {
            whole = whole.failed(step.outcome.detail());
        }
        spans.push(whole);
        self.file.add(spans);
    }
}

impl Asked {
    /// The span of this question. One that was not answered ends with the period.
    fn span(self, ids: &StepIds, moment: &Moment, decided: Time) -> Span {
        let (ended, answer) = match self.answer {
            Some((at, answer)) => (at.min(decided), Some(answer)),
            None => (decided, None),
        };
        let replica = self.replica.as_str();
        let times = moment.unix_ns(self.sent)..moment.unix_ns(ended);
        let span = Span::new(ids, name::ASK, Kind::Client, times)
            .with_id(ids.span(replica, name::ASK))
            .with_parent(ids.root())
            .with("egp.replica", replica);
        match answer {
            Some(Answer::Reply) => span.with("egp.answer", "reply"),
            Some(Answer::Error(error)) => span
                .with("egp.answer", "refused")
                .with("egp.error_code", error.code_name())
                .failed(error.to_string()),
            Some(Answer::Nothing) => span
                .with("egp.answer", "unreachable")
                .failed("the replica is not there, or the network does not let the query through"),
            None => span
                .with("egp.answer", "late")
                .failed("no answer had come when the period was decided"),
        }
    }
}
