//! The exchange with a fleet's map, whose service the test plays.

use std::time::Duration;

use egp_driver::{
    FleetAction, FleetExchange, FleetNotice, FleetSettings, FleetSettingsError, MapQuery, Purpose,
};
use egp_map::RoadBelief;
use egp_wire::road_keys::RoadKey;
use egp_wire::{Code, RoadTiles, TileEvidence, WireError, encode_tiles_changed};

use crate::fleet_car::{Car, SECOND, TILE, TIMEOUT, answer, keys, overloaded, road};
use crate::world::{ms, name};

#[test]
fn only_the_tiles_that_changed_are_asked_for() {
    let mut car = Car::new(4);
    for (tiles, asked) in [(vec![2], "2"), (vec![3, 1], "1")] {
        car.exchange.changed(&encode_tiles_changed(tiles));
        car.now += SECOND;
        let query = car.query_of_a_period();
        assert!(
            query.key.ends_with(&format!("/tiles/{asked}")),
            "{}",
            query.key
        );
        car.replied(&query, &answer(&[2], true));
        if asked == "2" {
            // The last one that changed was answered.
            assert!(car.queries().is_empty());
        } else {
            let next = car.query();
            assert!(next.key.ends_with("/tiles/3"), "{}", next.key);
            car.replied(&next, &answer(&[3], false));
        }
    }
    // Tiles beyond the end of the road, and no tiles, change nothing.
    car.exchange.changed(&encode_tiles_changed(vec![4000]));
    car.exchange.changed(&encode_tiles_changed(vec![]));
    car.now += SECOND;
    assert!(car.period().is_empty());
}

#[test]
fn an_answer_that_comes_twice_asks_on_once() {
    let mut car = Car::new(5);
    car.exchange.fetch(car.now);
    let mut asked = Vec::new();
    let mut queries = car.queries();
    while let Some(query) = queries.pop() {
        let last = asked.len();
        asked.push(query.key.clone());
        let page = answer(&[last], last < 4);
        for _ in 0..2 {
            (car.exchange).replied(car.now, query.id, &page, &mut car.belief);
        }
        car.ended(&query);
        queries.extend(car.queries());
    }
    let tiles = [0, 1, 2, 3, 4].map(|first| format!("egp/v1/map/depot/car-7/ring/tiles/{first}"));
    assert_eq!(asked, tiles);
}

#[test]
fn after_lost_publications_all_tiles_are_asked_for() {
    let mut car = Car::new(4);
    car.exchange.changed(&encode_tiles_changed(vec![2]));
    car.exchange.publications_lost();
    car.now += SECOND;
    let query = car.query_of_a_period();
    assert!(query.key.ends_with("/tiles/0"), "{}", query.key);
    car.replied(&query, &answer(&[0, 1, 2], true));
    let next = car.query();
    assert!(next.key.ends_with("/tiles/3"), "{}", next.key);
    car.replied(&next, &answer(&[3], false));
    assert!(car.queries().is_empty());
}

#[test]
fn evidence_is_sent_once_a_second_and_again_until_it_is_acknowledged() {
    let mut car = Car::new(2);
    car.measure(0, 1);
    assert_eq!(car.unsent(), 2);
    assert!(car.period().is_empty());
    car.now += SECOND;
    let sent = car.period();
    assert_eq!(
        keys(&sent),
        [0, 1].map(|tile| format!("egp/v1/map/depot/car-7/ring/tile/{tile}"))
    );
    let evidence = TileEvidence::decode(sent[1].payload.as_ref().unwrap()).unwrap();
    assert_eq!(evidence.age_ms, 1000);
    assert_eq!(evidence.rows, car.belief.tile(1).unwrap().bytes());
    assert_eq!(car.unsent(), 2); // no answer yet
    car.replied(&sent[0], b"");
    car.refused(&sent[1], &overloaded());
    assert_eq!(car.unsent(), 1);
    car.now += SECOND;
    let again = car.period().pop().unwrap();
    assert_eq!(again.key, sent[1].key);
    let evidence = TileEvidence::decode(again.payload.as_ref().unwrap()).unwrap();
    assert_eq!(evidence.age_ms, 2000);
    car.refused(&again, &WireError::permanent(Code::TooLate, "too old"));
    assert_eq!(car.unsent(), 0); // the same evidence would get the same error
    assert!(!car.exchange.silent() && car.queries().is_empty());
    let codes: Vec<_> = (car.notices.iter())
        .map(|notice| match notice {
            FleetNotice::Refused(Purpose::Evidence, error) => error.code,
            other => panic!("{other}"),
        })
        .collect();
    assert_eq!(codes, [Code::Overloaded, Code::TooLate]);
}

#[test]
fn evidence_that_changes_while_it_is_sent_is_sent_again_as_it_is_then() {
    let mut car = Car::new(1);
    car.measure(0, 0);
    car.now += SECOND;
    let first = car.query_of_a_period();
    car.measure(0, 0);
    car.now += SECOND;
    assert!(car.period().is_empty()); // one message about a tile at a time
    assert_eq!(car.unsent(), 1);
    car.refused(&first, &overloaded());
    assert!(car.queries().is_empty());
    car.now += SECOND;
    let second = car.query_of_a_period();
    let [before, now] = [&first, &second]
        .map(|query| TileEvidence::decode(query.payload.as_ref().unwrap()).unwrap());
    assert_ne!(before.rows, now.rows);
    assert_eq!(now.age_ms, 1000); // since the change was noticed
}

#[test]
fn after_a_silence_everything_is_asked_for_and_sent_again() {
    let mut car = Car::new(3);
    car.measure(0, 1);
    car.now += SECOND;
    for query in car.period() {
        car.replied(&query, b"");
    }
    assert_eq!(car.unsent(), 0);
    car.measure(2, 2);
    car.now += SECOND;
    let lost = car.query_of_a_period();
    car.ended(&lost);
    assert_eq!(car.unsent(), 1); // what was acknowledged counts as sent until the service answers again
    car.now += SECOND;
    let [evidence, question] = <[MapQuery; 2]>::try_from(car.period()).unwrap();
    assert_eq!(evidence.key, lost.key);
    assert!(question.key.ends_with("/tiles/0"), "{}", question.key);
    car.replied(&question, &RoadTiles::default().encode());
    assert_eq!(car.unsent(), 3);
    car.replied(&evidence, b"");
    car.now += SECOND;
    let again = car.period();
    assert_eq!(
        keys(&again),
        [0, 1].map(|tile| format!("egp/v1/map/depot/car-7/ring/tile/{tile}"))
    );
    let evidence = TileEvidence::decode(again[0].payload.as_ref().unwrap()).unwrap();
    assert_eq!(evidence.age_ms, 3000); // nothing was measured since
    for query in &again {
        car.replied(query, b"");
    }
    car.now += SECOND;
    assert!(car.period().is_empty());
    assert_eq!(car.unsent(), 0);
}

#[test]
fn at_most_16_tiles_are_sent_at_once() {
    let mut car = Car::new(20);
    car.measure(0, 19);
    car.now += SECOND;
    let mut sent = car.period();
    assert_eq!(sent.len(), 16);
    car.now += SECOND;
    assert!(car.period().is_empty());
    for query in &sent[..2] {
        car.replied(query, b"");
    }
    car.now += SECOND;
    sent.extend(car.period());
    assert_eq!(sent.len(), 18);
    assert!(sent[17].key.ends_with("/tile/17"), "{}", sent[17].key);
    assert_eq!(car.unsent(), 18);
}

#[test]
fn evidence_whose_age_no_message_can_state_is_dropped() {
    let mut car = Car::new(2);
    car.measure(0, 1);
    assert_eq!(car.unsent(), 2);
    car.now += Duration::from_secs(50 * 86_400);
    assert!(car.period().is_empty());
    assert_eq!(car.unsent(), 0);
}

#[test]
fn the_last_evidence_is_sent_once_and_what_is_left_is_said() {
    let mut car = Car::new(20);
    car.measure(0, 19);
    car.exchange.finish(car.now, &mut car.belief);
    let mut sent = car.queries();
    assert_eq!(sent.len(), 16);
    let mut tried = 0;
    while let Some(query) = sent.pop() {
        assert!(car.exchange.is_waiting());
        car.refused(&query, &overloaded());
        sent.extend(car.queries());
        tried += 1;
    }
    assert_eq!(tried, 20);
    assert!(!car.exchange.is_waiting() && !car.exchange.silent());
    assert_eq!(car.unsent(), 20);
    assert_eq!(car.notices.last(), Some(&FleetNotice::Unsent(20)));

    // If nobody answers, the time-out ends the wait.
    car.exchange.finish(car.now, &mut car.belief);
    let sent = car.queries();
    car.replied(&sent[0], b"");
    assert_eq!(car.queries().len(), 1);
    let end = car.now + TIMEOUT;
    car.wake();
    assert_eq!(car.now, end);
    assert!(!car.exchange.is_waiting() && car.exchange.silent());
    assert!(car.queries().is_empty());
    assert_eq!(car.notices.last(), Some(&FleetNotice::Unsent(19)));

    // A silent service is not waited for.
    car.exchange.finish(car.now, &mut car.belief);
    assert!(!car.exchange.is_waiting());
}

#[test]
fn reports_age_while_the_service_is_silent_one_in_each_period() {
    let mut car = Car::new(5); // evidence about a tile also tells something about those beside it
    car.exchange.fetch(car.now);
    let query = car.query();
    car.replied(&query, &answer(&[0, 2, 4], false));
    let mut before = [0, 2, 4].map(|tile| car.median(tile));
    // Whether a tile is aged in each of four periods that begin this many seconds later.
    for (seconds, ages) in [(59, [false; 4]), (1, [true, true, true, false])] {
        car.now += Duration::from_secs(seconds);
        for expected in ages {
            assert!(car.period().is_empty());
            let after = [0, 2, 4].map(|tile| car.median(tile));
            assert_eq!(before != after, expected, "{:?}", car.now);
            before = after;
        }
    }
    car.now += Duration::from_secs(12_000); // everything is forgotten by then
    for aged in 1..=3 {
        car.period();
        let forgotten = |tile: &usize| (car.median(*tile) - 0.5017).abs() > 0.01;
        assert_eq!([0, 2, 4].into_iter().filter(forgotten).count(), aged);
    }
}

#[test]
fn what_cannot_be_read_is_noticed_once() {
    let mut car = Car::new(1);
    for _ in 0..2 {
        car.exchange.changed(b"\xff");
        car.exchange.fetch(car.now);
        let query = car.query();
        car.replied(&query, b"\xff");
    }
    assert!(car.queries().is_empty());
    assert!(matches!(
        car.notices[..],
        [
            FleetNotice::UnreadablePublication(_),
            FleetNotice::UnreadableAnswer(_)
        ]
    ));
    assert!(car.notices.iter().all(FleetNotice::is_warning));
    // Answers to questions that were not asked are left out.
    let stray = car.exchange.clone();
    let id = egp_driver::QueryId(99);
    (car.exchange).replied(car.now, id, &answer(&[0], false), &mut car.belief);
    car.exchange.refused(id, &overloaded().encode());
    car.exchange.ended(car.now, id, &mut car.belief);
    assert_eq!(car.exchange.origins(car.now), stray.origins(car.now));
    assert!(car.queries().is_empty());
}

#[test]
fn a_text_of_zenoh_is_no_answer_of_a_service() {
    let mut car = Car::new(1);
    car.exchange.fetch(car.now);
    let query = car.query();
    car.exchange.refused(query.id, b"Timeout");
    car.ended(&query);
    assert!(car.exchange.silent() && car.exchange.is_waiting());
}

/// The tiles of a road with cells of other lengths mean other places.
#[test]
fn the_length_of_short_cells_is_a_part_of_the_keys() {
    let mut belief = RoadBelief::new(60.0, true)
        .unwrap()
        .with_scale(0.125)
        .unwrap();
    let mut small = |road| FleetExchange::new(road, FleetSettings::default(), ms(0), &mut belief);
    let mut exchange = small(road()).unwrap();
    assert_eq!(exchange.publications(), "egp/v1/@map/depot/ring.250mm");
    exchange.fetch(ms(0));
    let Some(FleetAction::Ask(query)) = exchange.next_action() else {
        panic!("no question");
    };
    assert_eq!(query.key, "egp/v1/map/depot/car-7/ring.250mm/tiles/0");
    let long = RoadKey {
        road: name(&"r".repeat(60)),
        ..road()
    };
    assert!(matches!(small(long), Err(FleetSettingsError::Road(_))));
}

#[test]
fn settings_out_of_range_are_errors() {
    let made = |lifetime, timeout| {
        let mut belief = RoadBelief::new(TILE, false).unwrap();
        let settings = FleetSettings { lifetime, timeout };
        FleetExchange::new(road(), settings, ms(0), &mut belief)
    };
    for lifetime in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let message = made(lifetime, SECOND).unwrap_err().to_string();
        assert!(message.contains("positive number of seconds"), "{message}");
    }
    let message = made(1.0, Duration::MAX).unwrap_err().to_string();
    assert!(message.contains("at most a day"), "{message}");
}
