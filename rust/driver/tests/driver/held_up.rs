//! A caller that was held up for longer than a tail: no plan from before is driven, and no transition spans the gap.

use std::time::Duration;

use egp_driver::{Driver, Measurement, Outcome};
use egp_gate::Mode;
use egp_wire::Ready;

use crate::world::{
    BUDGET, PERIOD, answered_period, asked, configured, decided, driver, ms, request, solved, tick,
};

/// The longest delay after a period's end that is not counted: almost three periods.
const JUST_BRIDGED: Duration = Duration::from_nanos(59_999_999);

/// A driver whose tail bridges two periods, after two answered ones at 20 and 40 ms. The next tick is due at 60 ms.
fn driving() -> Driver {
    let config = egp_driver::DriverConfig {
        max_tail_ticks: Some(2),
        ..crate::world::config()
    };
    let mut driver = configured(&["a"], config);
    answered_period(&mut driver, ms(20));
    answered_period(&mut driver, ms(40));
    driver
}

#[test]
fn periods_that_passed_count_and_the_history_starts_anew() {
    let mut driver = driving();
    tick(&mut driver, ms(60) + 3 * PERIOD);
    let query = asked(&mut driver);
    let next = request(&query);
    assert_eq!((next.sequence, next.history_z.len()), (6, 0));
    assert!(next.plan_u.is_empty(), "the plan of four inputs has ended");
    assert_eq!(next.weights, [0.25, 0.75], "the road is the same");
    driver.replied(ms(121), query.id, &solved(&query).encode(), b"");
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.held_up), (Mode::Normal, 3));
    // The next period follows in time.
    tick(&mut driver, ms(140));
    assert_eq!(request(&asked(&mut driver)).history_z.len(), 1);
    driver.wake(ms(140) + BUDGET);
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.held_up), (Mode::Tail, 0));
}

#[test]
fn without_an_answer_after_it_the_vehicle_stops() {
    let mut driver = driving();
    tick(&mut driver, ms(60) + 3 * PERIOD);
    asked(&mut driver);
    driver.wake(ms(140));
    let step = decided(&mut driver);
    assert_eq!(
        (step.outcome, step.command.mode),
        (Outcome::Late, Mode::Stop)
    );
    assert!(step.command.u[0] < 0.0);
}

#[test]
fn a_delay_that_a_plan_may_bridge_is_not_counted() {
    let mut driver = driving();
    tick(&mut driver, ms(60) + JUST_BRIDGED);
    let query = asked(&mut driver);
    let next = request(&query);
    assert_eq!((next.sequence, next.history_z.len()), (3, 2));
    driver.wake(ms(140));
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.held_up), (Mode::Tail, 0));
}

#[test]
fn a_caller_that_is_held_up_while_it_waits_does_not_drive_the_plan_either() {
    let mut driver = driving();
    tick(&mut driver, ms(60));
    let query = asked(&mut driver);
    // The answer comes when the program goes on, before it looks at the time.
    let resumed = ms(80) + 3 * PERIOD;
    driver.replied(resumed, query.id, &solved(&query).encode(), b"");
    driver.wake(resumed);
    let step = decided(&mut driver);
    assert_eq!((step.late.len(), step.held_up), (1, 3));
    assert_eq!(step.command.mode, Mode::Stop);
    // The gap is counted once.
    tick(&mut driver, resumed + PERIOD);
    assert_eq!(request(&asked(&mut driver)).sequence, 7);
}

#[test]
fn a_caller_that_is_held_up_between_an_answers_arrival_and_its_use_does_not_drive_the_plan() {
    for (resumed, held_up, mode) in [
        (ms(80) + JUST_BRIDGED, 0, Mode::Normal),
        (ms(80) + 3 * PERIOD, 3, Mode::Stop),
    ] {
        let mut driver = driving();
        tick(&mut driver, ms(60));
        let query = asked(&mut driver);
        // The answer came in time, and the program looks at it when it goes on.
        driver.clock(resumed);
        driver.replied(ms(61), query.id, &solved(&query).encode(), b"");
        let step = decided(&mut driver);
        assert!(step.outcome.is_solved());
        assert_eq!(step.latency, Some(ms(1)));
        assert_eq!((step.command.mode, step.held_up), (mode, held_up));
        // A gap is counted once, and a delay that is not counted yet goes on after the command.
        tick(&mut driver, resumed + PERIOD);
        assert_eq!(request(&asked(&mut driver)).sequence, 7);
    }
}

#[test]
fn a_delay_that_goes_on_after_the_command_is_one_delay() {
    let mut driver = driving();
    tick(&mut driver, ms(60));
    asked(&mut driver);
    driver.wake(ms(80) + JUST_BRIDGED);
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.held_up), (Mode::Tail, 0));
    tick(&mut driver, ms(80) + 2 * JUST_BRIDGED);
    assert!(request(&asked(&mut driver)).history_z.is_empty());
    driver.wake(ms(220));
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.held_up), (Mode::Stop, 5));
}

#[test]
fn a_long_deadline_is_no_hold_up() {
    let mut driver = driving();
    let measurement = crate::world::measurement();
    driver.tick(ms(60), ms(1060), measurement).unwrap();
    let query = asked(&mut driver);
    driver.replied(ms(1000), query.id, &solved(&query).encode(), b"");
    assert_eq!(decided(&mut driver).held_up, 0);
    tick(&mut driver, ms(1000) + JUST_BRIDGED);
    let query = asked(&mut driver);
    assert_eq!(request(&query).history_z.len(), 3);
    driver.replied(ms(1060), query.id, &solved(&query).encode(), b"");
    assert_eq!(decided(&mut driver).held_up, 0);
    // An answer long before the deadline ends the time in which the caller waits.
    let deadline = ms(5000);
    let measurement = crate::world::measurement();
    driver.tick(ms(1080), deadline, measurement).unwrap();
    let query = asked(&mut driver);
    driver.replied(ms(1081), query.id, &solved(&query).encode(), b"");
    assert_eq!(decided(&mut driver).held_up, 0);
    tick(&mut driver, ms(1100) + 3 * PERIOD);
    asked(&mut driver);
    driver.wake(ms(1180));
    assert_eq!(decided(&mut driver).held_up, 3);
}

#[test]
fn a_reset_and_a_first_tick_are_no_hold_up() {
    let mut driver = driver(&["a"]);
    tick(&mut driver, Duration::from_secs(3600));
    assert_eq!(request(&asked(&mut driver)).sequence, 1);
    driver.reset();
    tick(&mut driver, Duration::from_secs(7200));
    assert_eq!(request(&asked(&mut driver)).sequence, 2);
}

#[test]
fn a_delay_longer_than_the_plan_counts_although_the_tail_may_last_longer() {
    // The plan of four inputs ends three periods after its first one. The tail may last 25 periods.
    let held_up = |delay: Duration| {
        let mut driver = driver(&["a"]);
        answered_period(&mut driver, ms(20));
        answered_period(&mut driver, ms(40));
        tick(&mut driver, ms(60) + delay);
        let history = request(&asked(&mut driver)).history_z.len();
        driver.wake(ms(60) + delay + BUDGET);
        let step = decided(&mut driver);
        (step.held_up, history, step.command.mode)
    };
    let one_less = Duration::from_nanos(79_999_999);
    assert_eq!(held_up(one_less), (0, 2, Mode::Tail));
    assert_eq!(held_up(4 * PERIOD), (4, 0, Mode::Stop));
}

#[test]
fn by_default_the_tail_lasts_half_a_second_at_any_period() {
    for (dt, ticks) in [(0.02, 25), (0.05, 10), (0.1, 5), (1.0 / 30.0, 15), (2.0, 1)] {
        let served = Ready {
            dt,
            horizon: 128,
            ..crate::world::served()
        };
        let mut driver = Driver::new(crate::world::config(), served).unwrap();
        crate::world::appear(&mut driver, &crate::world::name("a"));
        let period = Duration::from_secs_f64(dt);
        let mut held_up = |now: Duration| {
            let measurement = Measurement {
                reference: vec![[3.0, 4.0, 12.0, 0.0]; 129],
                ..crate::world::measurement()
            };
            driver.tick(now, now, measurement).unwrap();
            decided(&mut driver).held_up
        };
        // A tick is due one period after the one before it.
        assert_eq!(held_up(period), 0);
        assert_eq!(held_up(period * (2 + ticks)), 0, "{dt}");
        assert_eq!(held_up(period * (4 + 2 * ticks)), u64::from(ticks) + 1);
    }
}
