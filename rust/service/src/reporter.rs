//! What a service does from time to time: it publishes its load, counts its links, and asks whether its name is its own.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use egp_wire::keys;
use prometheus_client::metrics::counter::Counter;
use prost::Message as _;

use crate::intake::Shared;
use crate::links::{LOOK, Links};
use crate::network::{Publisher, Received, Surroundings};

/// Time from the start of the thread, and then between two questions, for the services of this name.
const FIRST: Duration = Duration::from_secs(1);
const AGAIN: Duration = Duration::from_secs(60);
/// Time in which those services answer.
const ANSWER: Duration = Duration::from_secs(1);

/// What the thread works with.
pub(crate) struct Reporter {
    pub(crate) shared: Arc<Shared<Received>>,
    pub(crate) publisher: Publisher,
    pub(crate) surroundings: Surroundings,
    pub(crate) links: Arc<Links>,
    /// Questions that another service answered, too.
    pub(crate) twice: Counter,
    /// Time between two publications of the load.
    pub(crate) period: Duration,
}

impl Reporter {
    /// Works until the sender of `stop` is dropped.
    pub(crate) fn run(&self, stop: &Receiver<()>) {
        let begun = Instant::now();
        let (mut publish, mut ask) = (begun + self.period, begun + FIRST);
        let mut asked: Option<(Instant, Arc<AtomicUsize>)> = None;
        loop {
            let wait = publish.saturating_duration_since(Instant::now()).min(LOOK);
            if stop.recv_timeout(wait) != Err(RecvTimeoutError::Timeout) {
                return;
            }
            self.links.note(self.surroundings.links());
            let now = Instant::now();
            if now >= publish {
                self.publisher.publish(self.shared.load().encode_to_vec());
                publish = now + self.period;
            }
            if now >= ask {
                let key = keys::health(&self.shared.replica);
                asked = Some((now, self.surroundings.answers(&key, ANSWER)));
                ask = now + AGAIN;
            }
            // The question may have its last answer a little after its time.
            if let Some((_, answers)) = asked.take_if(|(at, _)| now - *at > 2 * ANSWER) {
                self.judge(answers.load(Ordering::Relaxed));
            }
        }
    }

    /// Reports that another service has the name of this one, if there was more than its own answer.
    fn judge(&self, answers: usize) {
        if answers > 1 {
            self.twice.inc();
            tracing::warn!(
                replica = %self.shared.replica,
                answers,
                "another service has this name, and each vehicle reaches either of them; give one of them another --replica"
            );
        }
    }
}
