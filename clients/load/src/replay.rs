//! Recorded requests, sent again on a fixed schedule without a plant; no other file of this crate uses zenoh.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use egp_simulator::CAR;
use egp_vehicle::{GateLimits, VehicleConfig, open_session};
use egp_wire::keys::{self, Name};
use egp_wire::{Interrupt, Ready, Request, print_notice};
use zenoh::bytes::ZBytes;
use zenoh::query::Reply;
use zenoh::{Session, Wait};

use crate::counts::{Counts, Sent};
use crate::{Arguments, Failure, recording};

/// How long a late answer is waited for.
const PATIENCE: Duration = Duration::from_secs(1);
/// Time for which the same replicas must be found.
const SAME: Duration = Duration::from_secs(1);

/// The vehicles that replay one recording.
pub(crate) struct Replay<'a> {
    arguments: &'a Arguments,
    requests: Vec<ZBytes>,
    replicas: Vec<Name>,
    sessions: Vec<Session>,
    /// Control period of the recording's library.
    pub(crate) period: Duration,
    budget: Duration,
}

impl<'a> Replay<'a> {
    /// Connects, and prepares the requests: each gets the budget of the arguments.
    ///
    /// # Errors
    /// A message if no replica says what it serves, the recording does not fit those that do
    /// ([`recording::UnfitRecording`]), or the budget is below 1 us.
    pub(crate) fn new(arguments: &'a Arguments, recorded: Vec<Request>) -> Result<Self, Failure> {
        let first = session(arguments, 0)?;
        let mut described = Vec::new();
        for replica in live(&first)? {
            match ready(&first, &replica) {
                Ok(ready) => described.push((replica, ready)),
                Err(error) => print_notice(format_args!("egp-load: {error}, and gets no requests")),
            }
        }
        if described.is_empty() {
            return Err("no replica says what it serves; start one that does".into());
        }
        let period = Duration::try_from_secs_f64(recording::period(&described, &recorded)?)?;
        let budget = period.mul_f64(arguments.budget);
        let budget_us = u32::try_from(budget.as_micros())?;
        if budget_us == 0 {
            let (part, period) = (arguments.budget, period.as_secs_f64());
            let expected = "expected a budget of at least 1 us; choose a larger --budget";
            return Err(format!("{part} of the period of {period} s: {expected}").into());
        }
        let encode = |request| {
            Request {
                budget_us,
                ..request
            }
            .encode()
            .into()
        };
        Ok(Self {
            arguments,
            requests: recorded.into_iter().map(encode).collect(),
            replicas: described.into_iter().map(|(name, _)| name).collect(),
            sessions: vec![first],
            period,
            budget,
        })
    }

    /// Lets this many vehicles send a request each period, first for the time `warm_up`, then for `measured`, and counts
    /// what becomes of the requests that are due in the latter. Returns the counts and the time for which it was measured,
    /// which is shorter after Ctrl-C.
    ///
    /// # Errors
    /// A message if a session cannot be opened.
    pub(crate) fn run(
        &mut self,
        vehicles: usize,
        warm_up: Duration,
        measured: Duration,
        interrupt: &Interrupt,
    ) -> Result<(Counts, Duration), Failure> {
        let sessions = self.arguments.sessions.map_or(vehicles, |n| n as usize);
        while self.sessions.len() < sessions.min(vehicles) && !interrupt.came() {
            self.sessions
                .push(session(self.arguments, self.sessions.len())?);
        }
        let keys = (0..vehicles).map(|index| self.key(index));
        let keys = keys.collect::<Result<Vec<_>, _>>()?;
        let counts = Arc::new(Mutex::new(Counts {
            vehicles: vec![[0; 2]; vehicles],
            ..Counts::default()
        }));
        let ignored = Arc::new(Mutex::new(Counts::default()));
        let begin = Instant::now() + Duration::from_millis(200);
        for round in 0_u32.. {
            for (index, (key, session)) in keys.iter().zip(self.sessions.iter().cycle()).enumerate()
            {
                let part = index as f64 / vehicles as f64;
                let after = self.period.mul_f64(f64::from(round) + part);
                if after >= warm_up + measured {
                    return Ok((finish(&counts), measured));
                }
                if interrupt.came() {
                    return Ok((finish(&counts), after.saturating_sub(warm_up)));
                }
                let due = begin + after;
                thread::sleep(due.saturating_duration_since(Instant::now()));
                let counts = if after < warm_up { &ignored } else { &counts };
                let lag = due.elapsed();
                counts
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .lag
                    .record(lag);
                // The vehicles begin at places that are spread over the recording.
                let start = index * self.requests.len() / vehicles;
                let at = (start + round as usize) % self.requests.len();
                let sent = Sent {
                    due,
                    vehicle: index,
                    budget: self.budget,
                    counts: counts.clone(),
                    answered: AtomicBool::new(false),
                    copied: AtomicBool::new(false),
                };
                if let Some(request) = self.requests.get(at) {
                    ask(session, key, request.clone(), sent);
                }
            }
        }
        Ok((finish(&counts), measured))
    }

    fn key(&self, index: usize) -> Result<String, Failure> {
        let replica = self.replicas.get(index % self.replicas.len());
        let replica = replica.ok_or("no replica of the service is known")?;
        Ok(keys::step(replica, &"load".parse()?, &name(index).parse()?))
    }
}

/// The counts when the last answer has come or is no longer waited for.
fn finish(counts: &Arc<Mutex<Counts>>) -> Counts {
    let end = Instant::now() + PATIENCE + Duration::from_millis(500);
    // Each request that is under way holds the counts.
    while Arc::strong_count(counts) > 1 && Instant::now() < end {
        thread::sleep(Duration::from_millis(5));
    }
    let mut counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
    std::mem::take(&mut *counts)
}

fn name(index: usize) -> String {
    format!("car-{index}")
}

fn session(arguments: &Arguments, index: usize) -> Result<Session, Failure> {
    let limits = GateLimits::of(&CAR.vehicle());
    let config = VehicleConfig::new("load", &name(index), limits, &[])?
        .reached_by(&arguments.connect, arguments.zenoh.as_deref());
    Ok(open_session(&config)?)
}

/// The replicas that announce themselves, once the same ones were found for a second, or after ten seconds: links to some of
/// them may be slower than to others.
fn live(session: &Session) -> Result<Vec<Name>, Failure> {
    let end = Instant::now() + Duration::from_secs(10);
    let (mut last, mut since) = (Vec::new(), Instant::now());
    while Instant::now() < end {
        let tokens = session.liveliness().get(keys::ALL_LIVE).wait()?;
        let mut found: Vec<Name> = std::iter::from_fn(|| tokens.recv().ok())
            .filter_map(|reply| reply.into_result().ok())
            .filter_map(|sample| keys::replica_of_live(sample.key_expr().as_str()))
            .collect();
        found.sort();
        found.dedup();
        if found != last {
            (last, since) = (found, Instant::now());
        } else if !last.is_empty() && since.elapsed() >= SAME {
            return Ok(last);
        }
        thread::sleep(Duration::from_millis(50));
    }
    if !last.is_empty() {
        return Ok(last);
    }
    Err("no replica of the service announces itself; start one, or check --connect".into())
}

fn ready(session: &Session, replica: &Name) -> Result<Ready, Failure> {
    let replies = session.get(keys::ready(replica)).timeout(PATIENCE).wait()?;
    let answer = replies
        .recv()
        .ok()
        .and_then(|reply| reply.into_result().ok());
    let sample = answer.ok_or_else(|| format!("replica {replica} does not say what it serves"))?;
    let ready = Ready::decode(&sample.payload().to_bytes());
    Ok(ready.map_err(|error| format!("replica {replica} says what cannot be used: {error}"))?)
}

/// Sends a request; `sent` counts its answer.
fn ask(session: &Session, key: &str, request: ZBytes, sent: Sent) {
    let count = move |reply: Reply| match reply.into_result() {
        Ok(sample) => {
            let attachment = sample.attachment().map(|bytes| bytes.to_bytes());
            let attachment = attachment.as_deref().unwrap_or_default();
            sent.replied(&sample.payload().to_bytes(), attachment);
        }
        Err(error) => sent.refused(&error.payload().to_bytes()),
    };
    // An error drops `sent`, which counts a request without an answer.
    let _ = egp_vehicle::ask(session, key, request, Vec::new(), PATIENCE, count);
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use egp_testing::messages;
    use egp_testing::ports::free_endpoint;
    use zenoh::Config;

    use super::*;

    fn open(key: &str, endpoint: &str) -> Session {
        let mut config = Config::default();
        let endpoints = format!("[\"{endpoint}\"]");
        for (key, value) in [
            ("scouting/multicast/enabled", "false"),
            ("listen/endpoints", "[]"),
            (key, &endpoints),
        ] {
            config.insert_json5(key, value).unwrap();
        }
        zenoh::open(config).wait().unwrap()
    }

    #[test]
    fn a_reply_counts_when_it_comes_and_not_when_all_copies_of_the_question_have_ended() {
        let endpoint = free_endpoint();
        let replica = open("listen/endpoints", &endpoint);
        let held = Mutex::new(Vec::new());
        let answer = move |query: zenoh::query::Query| {
            let reply = messages::solved_reply().encode();
            query.reply(query.key_expr(), reply).wait().unwrap();
            held.lock().unwrap().push(query); // a query that is kept has no end
        };
        let answering = replica.declare_queryable("a").callback(answer).wait();
        let client = open("connect/endpoints", &endpoint);
        let late = Instant::now() + Duration::from_secs(60);
        // Questions before the client has heard of the queryable have no answer, and on a machine that stalls a reply is late.
        loop {
            let counts = Arc::new(Mutex::new(Counts::default()));
            let sent = Sent {
                due: Instant::now(),
                vehicle: 0,
                // A reply that waits for the end of the query comes after `PATIENCE`.
                budget: Duration::from_millis(999),
                counts: counts.clone(),
                answered: AtomicBool::new(false),
                copied: AtomicBool::new(false),
            };
            ask(&client, "a", ZBytes::default(), sent);
            while counts.lock().unwrap().outcomes.is_empty() {
                thread::sleep(Duration::from_millis(1));
            }
            if counts.lock().unwrap().outcomes.contains_key("solved") {
                break;
            }
            assert!(
                Instant::now() < late,
                "replies come with the end of the query"
            );
        }
        answering.unwrap().undeclare().wait().unwrap();
    }
}
