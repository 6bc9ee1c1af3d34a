//! What takes longer than a control period: asking for the whole road before a drive, and sending the last evidence after it.

use std::collections::BTreeSet;
use std::time::Duration;

use egp_map::RoadBelief;

use super::{FleetExchange, FleetNotice};
use crate::driver::Time;

/// The first question of [`FleetExchange::fetch`] may take the time-out divided by this, so that a lost answer is asked for
/// again. Later ones may take all of it, as the answers on a slow link do.
const FIRST_SHARE: u32 = 3;
/// Pause before [`FleetExchange::fetch`] asks again: the link may not be there yet.
const PAUSE: Duration = Duration::from_millis(50);

/// What the transport waits for.
#[derive(Clone, Debug)]
pub(super) enum Waiting {
    Fetch {
        until: Time,
        again: Option<Time>,
        /// Whether a map service has replied since the fetch began.
        replied: bool,
    },
    Finish {
        until: Time,
        tried: BTreeSet<u32>,
    },
}

impl FleetExchange {
    /// Asks for all tiles, again if there is no answer. Once [`Self::is_waiting`] is false, the map service has answered unless
    /// it is [`Self::silent`].
    pub fn fetch(&mut self, now: Time) {
        let until = now.saturating_add(self.settings.timeout);
        self.waiting = Some(Waiting::Fetch {
            until,
            again: None,
            replied: false,
        });
        self.silent = false;
        self.retry_after = Duration::ZERO;
        self.ask(0, self.last_tile(), self.settings.timeout / FIRST_SHARE);
    }

    /// Sends the last evidence, unless the service is silent. Once [`Self::is_waiting`] is false, [`Self::unsent`] tells what
    /// could not be sent.
    pub fn finish(&mut self, now: Time, belief: &mut RoadBelief) {
        let until = now.saturating_add(self.settings.timeout);
        let tried = BTreeSet::new();
        self.waiting = Some(Waiting::Finish { until, tried });
        if self.silent {
            self.end_waiting(now, belief);
        } else {
            self.send_rest(now, belief);
        }
    }

    /// Whether [`Self::fetch`] or [`Self::finish`] goes on.
    pub fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// When [`Self::wake`] is due, if at all.
    pub fn next_wake(&self) -> Option<Time> {
        match self.waiting {
            Some(Waiting::Fetch { until, again, .. }) => {
                Some(again.map_or(until, |at| at.min(until)))
            }
            Some(Waiting::Finish { until, .. }) => Some(until),
            None => None,
        }
    }

    /// States the present time while the transport waits.
    pub fn wake(&mut self, now: Time, belief: &mut RoadBelief) {
        match &mut self.waiting {
            Some(Waiting::Fetch { until, .. } | Waiting::Finish { until, .. }) if now >= *until => {
                self.silent |= match self.waiting {
                    Some(Waiting::Fetch { replied, .. }) => !replied,
                    _ => self.sends(),
                };
                self.end_waiting(now, belief);
            }
            Some(Waiting::Fetch { again, .. }) if again.is_some_and(|at| now >= at) => {
                *again = None;
                self.silent = false;
                self.ask(0, self.last_tile(), self.settings.timeout);
            }
            _ => {}
        }
    }

    /// Goes on with what the transport waits for after the end of a query.
    pub(super) fn go_on(&mut self, now: Time, belief: &mut RoadBelief) {
        let (silent, asks) = (self.silent, self.asks());
        match &mut self.waiting {
            Some(Waiting::Fetch { again, replied, .. }) => {
                *replied |= !silent;
                if asks {
                    return;
                }
                if silent || self.stale.is_some() {
                    *again = Some(now + PAUSE.max(self.retry_after));
                } else {
                    self.end_waiting(now, belief);
                }
            }
            Some(Waiting::Finish { .. }) => self.send_rest(now, belief),
            None => {}
        }
    }

    /// Sends evidence that was not tried since [`Self::finish`], or ends the waiting if there is none.
    fn send_rest(&mut self, now: Time, belief: &mut RoadBelief) {
        if let Some(Waiting::Finish { until, mut tried }) = self.waiting.take() {
            tried.extend(self.send(now, belief, &tried));
            self.waiting = Some(Waiting::Finish { until, tried });
            if !self.sends() {
                self.end_waiting(now, belief);
            }
        }
    }

    fn end_waiting(&mut self, now: Time, belief: &mut RoadBelief) {
        match self.waiting.take() {
            Some(Waiting::Fetch { .. }) if self.silent => self.notice(FleetNotice::NoAnswer),
            Some(Waiting::Finish { .. }) => {
                let left = self.unsent(now, belief);
                if left > 0 {
                    self.notice(FleetNotice::Unsent(left));
                }
            }
            _ => {}
        }
    }
}
