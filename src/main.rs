//! The `sandgait` command.

use std::process::ExitCode;

/// glibc's allocator keeps what sessions of many sizes leave behind: a server that 24 clients use grew for as long as they
/// did (`make study-load`).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    ExitCode::from(sandgait::cli::main(std::env::args_os()))
}
