//! Tests of a real service and real clients over TCP on the loopback.

mod allocation;
mod cores;
mod draining;
mod files;
mod hostile;
mod loopback;
mod map_store;
mod operating;
mod queueing;
mod reload;
mod seals;
mod serving;
