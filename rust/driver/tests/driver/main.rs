//! The state machine of the vehicle's side, event by event.
#![allow(clippy::unwrap_used, clippy::panic, clippy::float_cmp)]

mod carry;
mod descriptions;
mod fleet;
mod fleet_car;
mod fleet_fetch;
mod gate;
mod hedge;
mod held_up;
mod in_process;
mod interrupted;
mod measurements;
mod periods;
mod probes;
mod replies;
mod seals;
mod world;
