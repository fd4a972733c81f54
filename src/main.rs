//! The `sandgait` command.

use std::process::ExitCode;

/// mimalloc is used because glibc's allocator does not release the memory of sessions of many sizes. With it the memory
/// of a server with 24 clients grew as long as they ran (`make study-load`).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Number of mimalloc's option `purge_delay`, which its Rust binding does not name (`mi_option_e` in mimalloc.h).
const PURGE_DELAY: libmimalloc_sys::mi_option_t = 15;

/// Time after which unused memory goes back to the system [ms]: our choice. The default is 1,000; a server that answers
/// large requests then holds some 25 MiB more.
const DELAY: std::ffi::c_long = 0;

fn main() -> ExitCode {
    // SAFETY: it sets a number, before there is another thread.
    unsafe { libmimalloc_sys::mi_option_set_default(PURGE_DELAY, DELAY) };
    ExitCode::from(sandgait::cli::main(std::env::args_os()))
}
