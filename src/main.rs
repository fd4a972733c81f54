//! The `sandgait` command.

use std::process::ExitCode;

/// mimalloc, because glibc's allocator does not release the memory of sessions of many sizes: a server with 24
/// clients grew for as long as they ran (`make study-load`).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    ExitCode::from(sandgait::cli::main(std::env::args_os()))
}
