//! Sessions of a vehicle.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::{GateLimits, VehicleParameters};

#[test]
fn a_replica_whose_loss_is_reported_late_is_found_again() {
    let listen = [("listen/endpoints", r#"["tcp/127.0.0.1:0"]"#)];
    let config = egp_session::configuration(None, &DEFAULTS, listen.into_iter()).unwrap();
    let service = zenoh::open(config).wait().unwrap();
    let replica: Name = "a".parse().unwrap();
    let token = service
        .liveliness()
        .declare_token(keys::live(&replica))
        .wait()
        .unwrap();
    let endpoint = service.info().locators().wait()[0].to_string();
    let limits = GateLimits::of(&VehicleParameters::FORD_ESCORT);
    let config = VehicleConfig::new("test", "car", limits, &[&endpoint]).unwrap();
    let network = Network::open(&config).unwrap();
    let next = || {
        network
            .next(Duration::from_secs(10))
            .map(|event| event.kind)
    };
    assert!(matches!(next(), Some(EventKind::Appeared(_))));

    // The question after a silence is asked again, too.
    report(&network.sender, EventKind::Unknown(replica.clone()));
    assert!(matches!(next(), Some(EventKind::Unknown(_))));
    assert!(matches!(next(), Some(EventKind::Appeared(_))));

    report(&network.sender, EventKind::Gone(replica));
    assert!(matches!(next(), Some(EventKind::Gone(_))));
    assert!(matches!(next(), Some(EventKind::Appeared(_))));

    token.undeclare().wait().unwrap();
    assert!(matches!(next(), Some(EventKind::Gone(_))));
    assert!(network.next(Duration::from_millis(300)).is_none());
}
