//! `sandgait serve` as a process: its options, its log, and how it ends.

mod clock;
mod configuration;
mod connections;
#[expect(dead_code, reason = "servers inside the test are for other tests")]
#[path = "../grpc/harness.rs"]
mod harness;
#[path = "../testbed/long.rs"]
mod long;
mod operations;
mod process;
mod restarts;
mod security;
mod viewer;
