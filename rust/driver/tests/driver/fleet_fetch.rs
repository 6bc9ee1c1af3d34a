//! What a vehicle asks of a fleet's map before it drives.

use egp_driver::FleetNotice;
use egp_wire::{Code, RoadTiles, WireError, encode_tiles_changed};

use crate::fleet_car::{Car, SECOND, TIMEOUT, answer};
use crate::world::{ms, name};

#[test]
fn a_road_is_fetched_page_by_page() {
    let mut car = Car::new(4);
    let before = car.median(2);
    car.exchange.fetch(car.now);
    let first = car.query();
    assert_eq!(first.key, "egp/v1/map/depot/car-7/ring/tiles/0");
    assert_eq!((first.payload.as_ref(), first.listen), (None, SECOND));
    car.replied(&first, &answer(&[0, 2], true));
    assert!(car.exchange.is_waiting());
    let second = car.query();
    assert_eq!(second.key, "egp/v1/map/depot/car-7/ring/tiles/3");
    assert_eq!(second.listen, TIMEOUT);
    car.replied(&second, &answer(&[3, 4], false)); // the road has no tile 4
    assert!(!car.exchange.is_waiting() && !car.exchange.silent() && car.exchange.answered());
    assert!((car.median(2) - 0.5).abs() < 0.1, "{}", car.median(2));
    assert!((before - 0.5).abs() > 0.1, "{before}");
    car.now += SECOND;
    let origins: Vec<_> = car.exchange.origins(car.now).into_iter().collect();
    assert_eq!(origins, [(name("other"), ms(1500))]);
    assert_eq!(car.notices, []);
}

#[test]
fn a_map_service_that_answered_in_part_is_not_silent() {
    let mut car = Car::new(4);
    car.exchange.fetch(car.now);
    let first = car.query();
    car.now = ms(900);
    car.replied(&first, &answer(&[0], true));
    let second = car.query();
    car.now = TIMEOUT;
    car.wake();
    assert!(!car.exchange.is_waiting() && !car.exchange.silent());
    assert_eq!(car.notices, []);
    // The rest comes later.
    car.replied(&second, &answer(&[1, 2], false));
    assert!((car.median(2) - 0.5).abs() < 0.1);
}

#[test]
fn an_answer_that_leads_back_is_no_answer() {
    let mut car = Car::new(8);
    car.exchange.fetch(car.now);
    let first = car.query();
    car.replied(&first, &answer(&[0, 3], true));
    let second = car.query();
    assert_eq!(second.key, "egp/v1/map/depot/car-7/ring/tiles/4");
    car.replied(&second, &answer(&[2], true));
    assert!(car.exchange.is_waiting() && car.queries().is_empty());
    assert!(matches!(
        car.notices[..],
        [FleetNotice::UnreadableAnswer(_)]
    ));
}

#[test]
fn a_service_without_room_is_asked_again_when_it_says() {
    let mut car = Car::new(1);
    car.exchange.fetch(car.now);
    let first = car.query();
    car.refused(
        &first,
        &WireError::retryable(Code::Overloaded, 500_000, "busy"),
    );
    car.wake();
    assert_eq!(car.now, ms(500));
    assert_eq!(car.queries().len(), 1);
}

#[test]
fn an_answer_that_cannot_be_read_is_none() {
    let mut car = Car::new(1);
    car.exchange.fetch(car.now);
    while car.exchange.is_waiting() {
        for query in car.queries() {
            car.replied(&query, b"\xff");
        }
        car.wake();
    }
    assert!(car.exchange.silent() && !car.exchange.answered());
}

#[test]
fn a_lost_answer_is_asked_for_again_until_the_time_is_over() {
    let mut car = Car::new(1);
    car.exchange.fetch(car.now);
    let first = car.query();
    car.now = first.listen;
    car.ended(&first);
    assert!(car.queries().is_empty());
    car.wake();
    assert_eq!(car.now, ms(1050));
    let second = car.query();
    car.wake();
    assert_eq!(car.now, TIMEOUT);
    assert!(!car.exchange.is_waiting() && car.exchange.silent() && !car.exchange.answered());
    assert!(car.queries().is_empty());
    assert_eq!(car.notices, [FleetNotice::NoAnswer]);

    // The answer comes late, and is used.
    car.now += ms(20);
    car.replied(&second, &answer(&[0], false));
    assert!(!car.exchange.silent() && car.exchange.answered());
    assert!((car.median(0) - 0.5).abs() < 0.1);
}

#[test]
fn a_question_without_an_answer_is_asked_again_by_later_periods_and_noticed_once() {
    let mut car = Car::new(3);
    car.exchange.fetch(car.now);
    let first = car.query();
    car.replied(&first, &RoadTiles::default().encode());
    let changed = encode_tiles_changed(vec![1]);
    for round in 0..3 {
        car.exchange.changed(&changed);
        assert!(car.period().is_empty()); // less than a second after the last exchange
        car.now += SECOND;
        let query = car.period().pop().unwrap();
        // After a silence everything is asked for, since a publication may have been lost.
        let start = u32::from(round == 0);
        assert!(
            query.key.ends_with(&format!("/tiles/{start}")),
            "{}",
            query.key
        );
        assert!(car.period().is_empty()); // one question at a time
        car.ended(&query);
        assert!(car.exchange.silent());
    }
    assert!(car.queries().is_empty());
    assert_eq!(car.notices, [FleetNotice::NoAnswer]);
}
