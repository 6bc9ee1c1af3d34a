//! The service's spans of a request, which `docs/deploying.md`, section 3, describes.

use std::time::{Duration, Instant};

use egp_trace::{
    Counts, Kind, Moment, Resource, Share, Span, StepIds, TraceError, TraceFile, name,
};
use egp_wire::keys::{self, Name, Target};
use egp_wire::{Header, Status, WireError, status_name};

use crate::config::ServiceConfig;
use crate::intake::Job;
use crate::query::Query;

/// Writes the spans of the requests that were queued, after their answers were sent.
pub(crate) struct Traces {
    file: TraceFile,
    share: Share,
    epoch: Instant,
}

impl Traces {
    /// Opens the file of a configuration; none if it names no file.
    ///
    /// # Errors
    /// [`TraceError`] naming the file.
    pub(crate) fn open(config: &ServiceConfig, share: Share) -> Result<Option<Self>, TraceError> {
        let Some(path) = &config.traces else {
            return Ok(None);
        };
        let resource = Resource {
            service: "egp-server",
            instance: config.replica.clone(),
        };
        Ok(Some(Self {
            file: TraceFile::open(path, resource)?,
            share,
            epoch: Instant::now(),
        }))
    }

    /// What became of the spans so far.
    pub(crate) fn counts(&self) -> Counts {
        self.file.counts()
    }

    /// Writes the spans of a request, if its trace is among the share. The step began at `started`, if it began, and the
    /// answer was ready at `ended`.
    pub(crate) fn answered<Q: Query>(
        &self,
        replica: &Name,
        job: &Job<Q>,
        started: Option<Instant>,
        ended: Instant,
        outcome: Result<Status, &WireError>,
    ) {
        let Some(Target::Step { fleet, vehicle }) = keys::parse(job.query.key()) else {
            // Only requests are queued, so that there is no other key.
            return;
        };
        let payload = job.query.payload();
        let (replica, fleet, vehicle) = (replica.as_str(), fleet.as_str(), vehicle.as_str());
        let ids = StepIds::new(fleet, vehicle, &payload);
        if !self.share.contains(ids.trace()) {
            return;
        }
        let moment = Moment::now(|| self.epoch.elapsed());
        let at = |time| moment.unix_ns(self.since_epoch(time));
        let own = ids.span(replica, name::REQUEST);
        let mut whole = Span::new(
            &ids,
            name::REQUEST,
            Kind::Server,
            at(job.arrived)..at(ended),
        )
        .with_id(own)
        .with_parent(ids.span(replica, name::ASK))
        .with("egp.fleet", fleet)
        .with("egp.vehicle", vehicle)
        .with("egp.sequence", job.sequence);
        if let Ok(header) = Header::decode(&payload) {
            whole = whole.with("egp.library", &header.library);
        }
        whole = ended_with(whole, outcome);
        let part = |name, times| {
            Span::new(&ids, name, Kind::Internal, times)
                .with_id(ids.span(replica, name))
                .with_parent(own)
        };
        let queued = job.queued.unwrap_or(job.arrived);
        let mut spans = vec![
            part(name::RECEIVE, at(job.arrived)..at(queued)),
            part(name::QUEUE, at(queued)..at(started.unwrap_or(ended))),
        ];
        spans.extend(started.map(|started| part(name::SOLVE, at(started)..at(ended))));
        spans.push(whole);
        self.file.add(spans);
    }

    fn since_epoch(&self, time: Instant) -> Duration {
        time.saturating_duration_since(self.epoch)
    }
}

/// The span of a request with its outcome.
fn ended_with(span: Span, outcome: Result<Status, &WireError>) -> Span {
    match outcome {
        Ok(Status::Solved) => span.with("egp.status", status_name(Status::Solved)),
        Ok(status) => span
            .with("egp.status", status_name(status))
            .failed("the solver found no plan"),
        Err(error) => span
            .with("egp.error_code", error.code_name())
            .failed(error.to_string()),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::path::{Path, PathBuf};

    use egp_wire::Code;
    use serde_json::Value;

    use super::*;
    use crate::intake::Shared;
    use crate::intake::tests::shared;
    use crate::query::recorded::{Echo, Recorded, at};
    use crate::worker::Worker;

    /// What a service shares that writes traces into a folder of this name.
    fn traced(name: &str, share: f64) -> (Shared<Recorded>, PathBuf) {
        let folder = format!("egp-traces-{}-{name}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        std::fs::create_dir(&folder).unwrap();
        let path = folder.join("traces.jsonl");
        let mut config = ServiceConfig::new("unused");
        (config.traces, config.traces_share) = (Some(path.clone()), share);
        let traces = Traces::open(&config, config.share().unwrap()).unwrap();
        let mut shared = shared(1);
        shared.metrics.show_spans(traces.as_ref().unwrap().counts());
        shared.traces = traces;
        (shared, path)
    }

    /// The spans that a service wrote; it ends by that.
    fn written(shared: Shared<Recorded>, path: &Path) -> Vec<Value> {
        drop(shared);
        let text = std::fs::read_to_string(path).unwrap();
        std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
        let spans = |line| {
            let data: Value = serde_json::from_str(line).unwrap();
            data["resourceSpans"][0]["scopeSpans"][0]["spans"]
                .as_array()
                .unwrap()
                .clone()
        };
        text.lines().flat_map(spans).collect()
    }

    /// Name, length in ms and status of spans.
    fn summary(spans: &[Value]) -> Vec<(&str, u64, Option<u64>)> {
        let time = |span: &Value, key| span[key].as_str().unwrap().parse::<u64>().unwrap();
        let one = |span| {
            let took = time(span, "endTimeUnixNano") - time(span, "startTimeUnixNano");
            let name = span["name"].as_str().unwrap();
            (name, took / 1_000_000, span["status"]["code"].as_u64())
        };
        spans.iter().map(one).collect()
    }

    fn attribute<'a>(span: &'a Value, key: &str) -> Option<&'a str> {
        let all = span["attributes"].as_array()?;
        let found = all.iter().find(|each| each["key"] == key)?;
        found["value"]["stringValue"].as_str()
    }

    #[test]
    fn a_request_has_the_times_that_the_reply_states_and_ids_that_the_vehicle_computes() {
        let (shared, path) = traced("answered", 1.0);
        let (start, query) = (Instant::now(), Recorded::request("a", 5, 5_000_000));
        shared.take(query.clone(), start);
        let mut job = shared.queue.pop().unwrap();
        assert!(job.queued.is_some_and(|queued| queued >= start));
        job.queued = Some(at(start, 1.0));
        let begun = shared.begin(job, at(start, 3.0)).unwrap();
        let mut worker = Worker::new(4);
        let outcome = worker.compute(&shared, &Echo::default(), &begun);
        shared.finish(begun, &outcome, &worker.reply, at(start, 8.0));
        let spans = written(shared, &path);
        let whole = spans.last().unwrap();
        assert_eq!(
            summary(&spans),
            [
                ("egp.receive", 1, None),
                ("egp.queue", 2, None),
                ("egp.solve", 5, None),
                ("egp.request", 8, Some(2)), // the handler of this test finds no plan
            ]
        );
        assert_eq!(attribute(whole, "egp.status"), Some("iteration_limit"));
        let ids = StepIds::new("fleet", "a", &query.payload);
        assert_eq!(whole["traceId"], ids.trace().to_string());
        assert_eq!(
            whole["parentSpanId"],
            ids.span("main", name::ASK).to_string()
        );
        for part in &spans[..3] {
            assert_eq!(part["parentSpanId"], whole["spanId"]);
        }
    }

    #[test]
    fn errors_of_queued_requests_have_spans_and_others_have_none() {
        let (shared, path) = traced("errors", 1.0);
        let start = Instant::now();
        let old = Recorded::request("a", 1, 5_000_000);
        shared.take(old.clone(), start);
        shared.take(Recorded::request("a", 2, 5_000_000), start);
        assert_eq!(old.code(), Some(Code::Superseded));
        let late = shared.queue.pop().unwrap();
        assert!(shared.begin(late, at(start, 6_000.0)).is_none());
        shared.take(
            Recorded::new("egp/v1/r/main/fleet/a/step", vec![0xff]),
            start,
        );
        let spans = written(shared, &path);
        let codes: Vec<_> = (spans.iter().filter(|span| span["name"] == "egp.request"))
            .map(|span| attribute(span, "egp.error_code"))
            .collect();
        assert_eq!(codes, [Some("superseded"), Some("too_late")]);
        assert!(spans.iter().all(|span| span["name"] != "egp.solve"));
    }

    #[test]
    fn metrics_count_the_spans_of_the_chosen_share() {
        for (share, count) in [(1.0, 3), (0.0, 0)] {
            let (shared, path) = traced("counted", share);
            let start = Instant::now();
            shared.take(Recorded::request("a", 1, 5_000_000), start);
            let job = shared.queue.pop().unwrap();
            shared.refuse_job(&job, &shared.too_late(1));
            let shown = |text: &str| shared.metrics.text(0).contains(text);
            let line = format!("egp_spans_total{{outcome=\"written\"}} {count}\n");
            let end = Instant::now() + Duration::from_secs(60);
            while !shown(&line) {
                assert!(Instant::now() < end);
                std::thread::sleep(Duration::from_millis(20));
            }
            assert!(shown("egp_spans_total{outcome=\"dropped\"} 0\n"));
            assert!(shown("egp_spans_total{outcome=\"failed\"} 0\n"));
            assert_eq!(written(shared, &path).len(), count);
        }
    }
}
