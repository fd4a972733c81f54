//! `sandgait serve` as those see it who run it: the real program, its options, its log, its end.

mod clock;
mod configuration;
mod connections;
#[expect(dead_code, reason = "servers inside the test are for other tests")]
#[path = "../grpc/harness.rs"]
mod harness;
mod operations;
mod process;
mod restarts;
mod security;
mod viewer;
