//! Which replicas are alive, and in which order they are asked.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::time::Duration;

use egp_wire::keys::Name;

use crate::driver::Time;
use crate::rank::rank;

/// Duration of the first demotion, for which a replica that failed is asked last. A failure after a demotion has ended doubles
/// the duration; a failure during a demotion starts the same duration again.
const MIN_DEMOTION: Duration = Duration::from_secs(1);
/// Longest demotion.
const MAX_DEMOTION: Duration = Duration::from_secs(30);
/// A replica that has not failed for this long since the end of its demotion starts with the shortest demotion again.
const PROBATION: Duration = Duration::from_secs(60);
/// Time between two probes of a replica.
const PROBE_INTERVAL: Duration = Duration::from_millis(200);

/// Most replicas that are known at a time. Further ones that announce themselves count as absent: whoever may announce replicas
/// could otherwise fill the memory and delay each period.
const MOST: usize = 256;

/// Why a replica is asked last.
#[derive(Clone, Debug)]
struct Demotion {
    /// Until then the replica is asked last in any case; afterwards, until a probe was answered.
    until: Time,
    length: Duration,
    /// When the replica failed last.
    failed: Time,
    /// When the last probe was sent.
    probed: Option<Time>,
    /// Whether a probe was answered in time after it.
    ended: bool,
}

/// The live replicas in the order of a vehicle's rendezvous hash, with those that failed lately at the end.
///
/// Of the demoted replicas those that have answered since they failed come first, the last answer first. The others
/// follow, the earliest failure first: when no replica is known to work, each is asked in turn, and one that has been
/// started again is found although another one answered until it froze.
///
/// A replica fails by letting a deadline pass, by an answer that cannot be used, or by an error whose cause is not the
/// request, its timing or the load. Because a frozen replica may stay frozen, it is promoted again only once its demotion has passed and it
/// has answered a probe in time, so that no control period is spent on finding out.
///
/// A replica is asked for steps only once it has described what the vehicle needs ([`Replicas::fits`]). Its plans could be
/// made for another vehicle, which replies do not show.
#[derive(Clone, Debug)]
pub(crate) struct Replicas {
    fleet: Name,
    vehicle: Name,
    /// The live replicas in the order of the vehicle's hash.
    live: Vec<Name>,
    demoted: BTreeMap<Name, Demotion>,
    /// The live replicas that are not known to fit the vehicle, each with the time of its last probe.
    unchecked: BTreeMap<Name, Option<Time>>,
    /// When each replica last sent a usable reply.
    answered: BTreeMap<Name, Time>,
}

impl Replicas {
    pub(crate) fn new(fleet: Name, vehicle: Name) -> Self {
        Self {
            fleet,
            vehicle,
            live: Vec::new(),
            demoted: BTreeMap::new(),
            unchecked: BTreeMap::new(),
            answered: BTreeMap::new(),
        }
    }

    /// Notes that a replica is there; returns whether it is known now.
    pub(crate) fn appeared(&mut self, replica: Name) -> bool {
        if self.live.contains(&replica) {
            return true;
        }
        if self.live.len() >= MOST {
            return false;
        }
        self.unchecked.insert(replica.clone(), None);
        let mut live = std::mem::take(&mut self.live);
        live.push(replica);
        self.live = rank(&self.fleet, &self.vehicle, live);
        true
    }

    pub(crate) fn gone(&mut self, replica: &Name) {
        self.live.retain(|live| live != replica);
        self.unchecked.remove(replica);
        self.answered.remove(replica);
    }

    /// Notes that a replica serves what the vehicle needs; returns whether that was not known before.
    pub(crate) fn fits(&mut self, replica: &Name) -> bool {
        self.unchecked.remove(replica).is_some()
    }

    /// Whether a live replica is not known to fit the vehicle.
    pub(crate) fn is_unchecked(&self, replica: &Name) -> bool {
        self.unchecked.contains_key(replica)
    }

    /// Notes that a replica sent a usable reply; one that has gone since then is not kept.
    pub(crate) fn answered(&mut self, replica: &Name, now: Time) {
        if self.live.contains(replica) {
            self.answered.insert(replica.clone(), now);
        }
    }

    /// The live replicas in the order of the vehicle's hash.
    pub(crate) fn live(&self) -> &[Name] {
        &self.live
    }

    /// The live replicas that fit the vehicle, in the order to ask them.
    pub(crate) fn order(&self) -> Vec<Name> {
        let mut order = self.live.clone();
        order.retain(|replica| !self.is_unchecked(replica));
        // The sort is stable, so those that are not demoted keep their rank.
        order.sort_by_key(|replica| {
            let demotion = self.demoted.get(replica).filter(|demotion| !demotion.ended);
            demotion.map(|demotion| {
                let answered = self.answered.get(replica).copied();
                let recovered = answered.is_some_and(|at| at > demotion.failed);
                ((!recovered).then_some(demotion.failed), Reverse(answered))
            })
        });
        order
    }

    /// Notes that a replica failed.
    pub(crate) fn demote(&mut self, replica: &Name, now: Time) {
        // A live replica that has not answered a probe since it failed may still be frozen.
        let live = &self.live;
        self.demoted.retain(|replica, demotion| {
            (!demotion.ended && live.contains(replica))
                || now.saturating_sub(demotion.until) < PROBATION
        });
        let before = self.demoted.get(replica);
        let length = before.map_or(MIN_DEMOTION, |demotion| {
            if demotion.ended {
                (demotion.length * 2).min(MAX_DEMOTION)
            } else {
                demotion.length
            }
        });
        let demotion = Demotion {
            until: now.saturating_add(length),
            length,
            failed: now,
            probed: None,
            ended: false,
        };
        self.demoted.insert(replica.clone(), demotion);
    }

    /// A replica that is due to be probed: one that is not known to fit, or a demoted one whose time has passed.
    pub(crate) fn next_probe(&mut self, now: Time) -> Option<Name> {
        let passed = |(replica, demotion): &(&Name, &mut Demotion)| {
            self.live.contains(*replica) && !demotion.ended && now >= demotion.until
        };
        let demoted = (self.demoted.iter_mut().filter(passed))
            .map(|(replica, demotion)| (replica, &mut demotion.probed));
        let due = |(_, probed): &(&Name, &mut Option<Time>)| {
            probed.is_none_or(|sent| now.saturating_sub(sent) >= PROBE_INTERVAL)
        };
        // The one that was probed longest ago comes first, so that a frozen one does not keep others from being probed.
        let (replica, probed) = (self.unchecked.iter_mut().chain(demoted))
            .filter(due)
            .min_by_key(|(_, probed)| **probed)?;
        *probed = Some(now);
        Some(replica.clone())
    }

    /// Notes that the replica answered in time the probe that was sent at `sent`. A probe that was sent before the end of
    /// the demotion does not end the demotion.
    pub(crate) fn probe_answered(&mut self, replica: &Name, sent: Time) {
        if let Some(demotion) = self.demoted.get_mut(replica)
            && sent >= demotion.until
        {
            demotion.ended = true;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn seconds(value: f64) -> Time {
        Time::from_secs_f64(value)
    }

    /// Lets a replica that fits the vehicle announce itself.
    fn appear(replicas: &mut Replicas, replica: &Name) -> bool {
        let known = replicas.appeared(replica.clone());
        replicas.fits(replica);
        known
    }

    fn three() -> (Replicas, Vec<Name>) {
        let name = |text: &str| text.parse::<Name>().unwrap();
        let mut replicas = Replicas::new(name("fleet"), name("car"));
        for replica in ["a", "b", "c"] {
            appear(&mut replicas, &name(replica));
        }
        let order = replicas.order();
        (replicas, order)
    }

    #[test]
    fn a_replica_that_failed_is_asked_last_until_a_probe_after_its_demotion_is_answered() {
        let (mut replicas, usual) = three();
        replicas.demote(&usual[0], seconds(5.0));
        let demoted = [usual[1].clone(), usual[2].clone(), usual[0].clone()];
        assert_eq!(replicas.order(), demoted);
        assert_eq!(replicas.next_probe(seconds(5.9)), None);
        assert_eq!(replicas.next_probe(seconds(6.0)), Some(usual[0].clone()));
        assert_eq!(
            replicas.next_probe(seconds(6.1)),
            None,
            "one probe at a time"
        );
        assert_eq!(replicas.next_probe(seconds(6.2)), Some(usual[0].clone()));
        assert_eq!(replicas.order(), demoted, "no probe was answered");
        replicas.probe_answered(&usual[0], seconds(6.2));
        assert_eq!(replicas.order(), usual);
        assert_eq!(replicas.next_probe(seconds(9.0)), None);
    }

    #[test]
    fn beyond_256_replicas_a_further_one_is_known_only_once_another_has_gone() {
        let (mut replicas, usual) = three();
        let name = |i: usize| format!("r{i}").parse::<Name>().unwrap();
        for i in usual.len()..MOST {
            assert!(appear(&mut replicas, &name(i)));
        }
        assert!(!replicas.appeared(name(MOST)));
        assert!(replicas.appeared(usual[0].clone()), "it is known already");
        assert_eq!(replicas.order().len(), MOST);
        let ranked = rank(&replicas.fleet, &replicas.vehicle, replicas.order());
        assert_eq!(replicas.order(), ranked);
        replicas.gone(&usual[0]);
        assert!(appear(&mut replicas, &name(MOST)));
    }

    #[test]
    fn a_replica_is_probed_at_once_and_asked_only_after_it_is_known_to_fit() {
        let (mut replicas, usual) = three();
        let new: Name = "d".parse().unwrap();
        replicas.appeared(new.clone());
        assert_eq!(replicas.order(), usual);
        assert_eq!(replicas.next_probe(seconds(5.0)), Some(new.clone()));
        assert!(replicas.fits(&new) && !replicas.fits(&new));
        assert_eq!(replicas.order(), replicas.live());
    }

    #[test]
    fn a_probe_from_before_the_end_of_a_demotion_does_not_end_it() {
        let (mut replicas, usual) = three();
        replicas.demote(&usual[0], seconds(0.0)); // until 1 s
        replicas.probe_answered(&usual[0], seconds(0.9));
        assert_eq!(replicas.order().last(), Some(&usual[0]));
    }

    #[test]
    fn each_demoted_replica_is_probed_in_its_turn() {
        let (mut replicas, _) = three();
        for replica in ["a", "b", "c"] {
            replicas.demote(&replica.parse().unwrap(), seconds(0.0));
        }
        // Periods as long as the time between probes: one replica is due again in each of them.
        let probed = (0..6).map(|period| {
            let now = seconds(2.0) + PROBE_INTERVAL * period;
            replicas.next_probe(now).unwrap().to_string()
        });
        assert_eq!(probed.collect::<String>(), "abcabc");
    }

    #[test]
    fn replicas_that_have_gone_are_not_remembered() {
        let (mut replicas, usual) = three();
        replicas.gone(&usual[0]);
        replicas.answered(&usual[0], seconds(1.0)); // a late reply
        assert!(replicas.answered.is_empty());
    }

    #[test]
    fn demotions_double_up_to_half_a_minute_and_begin_anew_later() {
        let (mut replicas, usual) = three();
        let mut now = seconds(0.0);
        let mut lengths = Vec::new();
        for _ in 0..7 {
            replicas.demote(&usual[0], now);
            let start = now;
            while replicas.next_probe(now).is_none() {
                now += Duration::from_millis(500);
            }
            lengths.push(now.saturating_sub(start).as_secs());
            replicas.probe_answered(&usual[0], now);
        }
        assert_eq!(lengths, [1, 2, 4, 8, 16, 30, 30]);
        now += Duration::from_secs(60);
        replicas.demote(&usual[0], now);
        assert!(replicas.next_probe(now + MIN_DEMOTION).is_some());
    }

    #[test]
    fn demotions_begin_anew_a_minute_after_the_last_one_and_not_before() {
        let almost = seconds(61.0).saturating_sub(Duration::from_nanos(1));
        for (again, length) in [(almost, 2), (seconds(61.0), 1)] {
            let (mut replicas, usual) = three();
            replicas.demote(&usual[0], seconds(0.0)); // until 1 s
            replicas.probe_answered(&usual[0], seconds(1.0));
            replicas.demote(&usual[0], again);
            let promoted = again + Duration::from_secs(length);
            let before = promoted.saturating_sub(Duration::from_nanos(1));
            assert_eq!(replicas.next_probe(before), None);
            assert!(replicas.next_probe(promoted).is_some());
        }
    }

    #[test]
    fn a_replica_that_stays_frozen_is_not_forgiven_when_another_one_fails() {
        let (mut replicas, usual) = three();
        replicas.demote(&usual[0], seconds(0.0));
        replicas.demote(&usual[1], seconds(90.0));
        assert_eq!(replicas.order()[0], usual[2]);
        // One that is gone is forgotten, so that names of the past do not fill the memory.
        replicas.gone(&usual[0]);
        replicas.demote(&usual[1], seconds(91.0));
        appear(&mut replicas, &usual[0]);
        assert_eq!(replicas.order()[0], usual[0]);
    }

    #[test]
    fn repeated_failures_within_a_demotion_do_not_lengthen_it() {
        let (mut replicas, usual) = three();
        replicas.demote(&usual[0], seconds(0.0));
        replicas.demote(&usual[0], seconds(0.5));
        assert_eq!(replicas.next_probe(seconds(1.4)), None);
        assert!(replicas.next_probe(seconds(1.5)).is_some());
    }

    #[test]
    fn of_demoted_replicas_the_one_is_asked_first_that_last_answered() {
        let (mut replicas, usual) = three();
        for (replica, answered) in [(&usual[0], 1.0), (&usual[1], 3.0), (&usual[2], 2.0)] {
            replicas.answered(replica, seconds(answered));
            replicas.demote(replica, seconds(4.0));
        }
        let by_answer = [usual[1].clone(), usual[2].clone(), usual[0].clone()];
        assert_eq!(replicas.order(), by_answer);
        replicas.gone(&usual[1]);
        appear(&mut replicas, &usual[1]);
        let unknown_last = [usual[2].clone(), usual[0].clone(), usual[1].clone()];
        assert_eq!(replicas.order(), unknown_last);
    }

    #[test]
    fn demoted_replicas_that_do_not_answer_are_asked_in_turn() {
        let (mut replicas, usual) = three();
        replicas.gone(&usual[2]);
        let [first, second] = [usual[0].clone(), usual[1].clone()];
        // The second one was killed and started again, and the first one answered until it froze.
        replicas.demote(&second, seconds(1.0));
        replicas.answered(&first, seconds(2.0));
        replicas.demote(&first, seconds(2.02));
        assert_eq!(replicas.order(), [second.clone(), first.clone()]);
        replicas.demote(&second, seconds(2.04));
        assert_eq!(replicas.order(), [first.clone(), second.clone()]);
        replicas.demote(&first, seconds(2.06));
        assert_eq!(replicas.order(), [second.clone(), first.clone()]);
        // An answer ends the alternation.
        replicas.answered(&second, seconds(2.07));
        replicas.demote(&first, seconds(2.08));
        assert_eq!(replicas.order(), [second, first]);
    }

    #[test]
    fn only_live_replicas_are_asked_and_probed() {
        let (mut replicas, usual) = three();
        replicas.demote(&usual[0], seconds(0.0));
        replicas.gone(&usual[0]);
        assert_eq!(replicas.order(), usual[1..]);
        assert_eq!(replicas.next_probe(seconds(2.0)), None);
        appear(&mut replicas, &usual[0]);
        assert_eq!(
            replicas.order().last(),
            Some(&usual[0]),
            "it is still demoted"
        );
    }
}
