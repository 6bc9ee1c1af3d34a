//! How long a vehicle waits for a service.

use std::time::Duration;

use egp_service::{Server, ServiceConfig};
use egp_testing::ports::free_endpoint;
use egp_vehicle::{GateLimits, VehicleClient, VehicleConfig, VehicleParameters};

use crate::LIBRARY;

#[test]
fn a_vehicle_may_wait_without_an_end() {
    let endpoint = free_endpoint();
    let limits = GateLimits::of(&VehicleParameters::FORD_ESCORT);
    let mut config = VehicleConfig::new("test", "car", limits, &[&endpoint]).unwrap();
    config.patience = Duration::MAX;
    let mut service = ServiceConfig::new(LIBRARY);
    service.workers = Some(1);
    (service.zenoh).insert("listen/endpoints".to_owned(), format!("[\"{endpoint}\"]"));
    let server = Server::start(&service).unwrap();
    let mut client = VehicleClient::connect(&config).unwrap();
    assert_eq!(client.replicas().len(), 1);
    server.drain();
}
