//! `sandgait._native`: environments and studies in the Python process, and the command line.
//!
//! * [`local`]: the environments of one session; [`process`]: the threads that they share.
//! * [`remote`]: environments on servers.
//! * [`studies`]: the offline tools.
//! * [`train`]: learning gaits.
//! * [`wait`]: work that Python waits for without holding its lock, until it is done or interrupted.
//! * [`arrays`], [`values`], [`tables`]: numpy's arrays, keywords and tables from and to the crate's types.
//! * [`errors`]: the one map from errors to Python's exceptions.
//!
//! No lock of ours is held while Python's is waited for, and none is taken in a forked child that another thread may have
//! held in the parent.

mod arrays;
mod errors;
mod local;
mod process;
mod remote;
mod studies;
mod tables;
mod train;
mod values;
mod wait;

use pyo3::prelude::*;
use std::ffi::OsString;

/// As for the command: what sessions of many sizes leave behind is given back. Python's own memory is not touched.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Runs the command line, the program's name first, and gives the exit code.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    // SAFETY: the default action is no code of ours. Ctrl-C ends the command as it ends any other program; Python's
    // handler would wait for the command to come back.
    unsafe { libc::signal(libc::SIGINT, libc::SIG_DFL) };
    py.detach(|| sandgait::cli::main(arguments))
}

/// A robot's URDF or MJCF as one text, and what was left out of it.
#[pyfunction]
fn pack_robot(py: Python<'_>, path: std::path::PathBuf) -> PyResult<(String, Vec<String>)> {
    py.detach(|| sandgait::cli::pack_robot(&path)).map_err(|error| errors::raise(&error))
}

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::errors::StatusError;
    #[pymodule_export]
    use super::local::Local;
    #[pymodule_export]
    use super::main;
    #[pymodule_export]
    use super::pack_robot;
    #[pymodule_export]
    use super::process::threads;
    #[pymodule_export]
    use super::remote::{Request, Response, Stream, close_session, create_session, describe_server, rollout};
    #[pymodule_export]
    use super::studies::study;
    #[pymodule_export]
    use super::tables::describe;
    #[pymodule_export]
    use super::train::train;
}
