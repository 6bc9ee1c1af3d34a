//! Control periods that the transport ends without a command, or cannot open.

use egp_gate::Mode;

use crate::world::{
    BUDGET, answered_period, asked, decided, driver, measurement, ms, request, solved, tick,
};

#[test]
fn an_abandoned_period_gives_no_command_to_a_later_one() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    answered_period(&mut driver, ms(40));
    tick(&mut driver, ms(60));
    let query = asked(&mut driver);
    driver.abandon();
    assert_eq!(driver.next_wake(), None);
    // The answer is told before the next period, as transports do.
    driver.replied(ms(61), query.id, &solved(&query).encode(), b"");
    assert!(driver.next_action().is_none());
    tick(&mut driver, ms(80));
    let query = asked(&mut driver);
    let next = request(&query);
    assert_eq!((next.sequence, next.history_z.len()), (4, 0));
    assert_eq!(next.plan_shift, 1, "the late plan is used");
    driver.replied(ms(81), query.id, &solved(&query).encode(), b"");
    let step = decided(&mut driver);
    assert_eq!((step.command.mode, step.late.len()), (Mode::Normal, 1));
}

#[test]
fn a_command_that_was_not_fetched_is_not_that_of_a_later_period() {
    for abandoned in [false, true] {
        let mut driver = driver(&["a"]);
        tick(&mut driver, ms(20));
        let query = asked(&mut driver);
        driver.replied(ms(21), query.id, &solved(&query).encode(), b"");
        if abandoned {
            driver.abandon();
            assert!(driver.next_action().is_none());
        }
        let mut later = measurement();
        later.x[1] = -2.0;
        driver.tick(ms(40), ms(40) + BUDGET, later).unwrap();
        let query = asked(&mut driver);
        assert_eq!(request(&query).x[1], -2.0);
        driver.wake(ms(40) + BUDGET);
        assert_eq!(decided(&mut driver).request, query.payload);
    }
}

#[test]
fn a_period_that_cannot_be_opened_counts_and_leaves_a_gap_in_the_history() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    tick(&mut driver, ms(40));
    let open = asked(&mut driver);
    driver.skip_period(ms(60));
    driver.wake(ms(60) + BUDGET);
    assert!(driver.next_action().is_none(), "the one before is given up");
    driver.replied(ms(77), open.id, &solved(&open).encode(), b"");
    tick(&mut driver, ms(80));
    let next = request(&asked(&mut driver));
    assert_eq!((next.sequence, next.history_z.len()), (4, 0));
    assert_eq!(next.plan_shift, 2);
    driver.wake(ms(80) + BUDGET);
    assert_eq!(decided(&mut driver).held_up, 0);
}

#[test]
fn a_caller_that_is_held_up_before_a_period_that_cannot_be_opened_is_counted() {
    let mut driver = driver(&["a"]);
    answered_period(&mut driver, ms(20));
    driver.skip_period(ms(40 + 100));
    tick(&mut driver, ms(160));
    let query = asked(&mut driver);
    assert_eq!(request(&query).sequence, 8);
    driver.wake(ms(160) + BUDGET);
    assert_eq!(decided(&mut driver).held_up, 5);
}
