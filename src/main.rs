//! The `sandgait` command.

use std::process::ExitCode;

/// mimalloc is used because glibc's allocator does not release the memory of sessions of many sizes. With it the memory
/// of a server with 24 clients grew as long as they ran (`make study-load`).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    ExitCode::from(sandgait::cli::main(std::env::args_os()))
}
