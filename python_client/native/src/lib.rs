//! `sandgait._native`: environments and studies in the Python process, and the command line.
//!
//! * [`local`]: the environments of one session; [`process`]: the threads that they share.
//! * [`remote`]: environments on servers.
//! * [`bodies`]: sand's forces on bodies that another simulator moves.
//! * [`studies`]: the offline tools.
//! * [`train`]: learning gaits; [`external`]: with environments of another program.
//! * [`wait`]: work that Python waits for without holding its lock.
//! * [`arrays`], [`values`], [`tables`]: numpy's arrays, keywords and tables from and to the crate's types.
//! * [`errors`]: the map from errors to Python's exceptions.
//!
//! This module never waits for Python's lock while it holds its own. In a forked child it takes no lock that
//! another thread may have held in the parent.

mod arrays;
mod bodies;
mod errors;
mod external;
mod local;
mod process;
mod remote;
mod studies;
mod tables;
mod train;
mod values;
mod wait;

use pyo3::prelude::*;
use sandgait::robots::Reading;
use std::ffi::OsString;
use std::path::PathBuf;

/// mimalloc, as in the command, so that the memory of sessions of many sizes is released. Python's own memory is
/// not affected.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Runs the command line, the program's name first, and returns the exit code.
#[pyfunction]
fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    // SAFETY: the default action runs no code of ours. Ctrl-C ends the command like any other program; Python's
    // handler would run only after the command.
    unsafe { libc::signal(libc::SIGINT, libc::SIG_DFL) };
    py.detach(|| sandgait::cli::main(arguments))
}

/// A robot as one text, with notes on the parts of its description that were left out, and the time step that it needs
/// [s] or None. `robot`: a file, a name, or `name=file`; `folders`: where packages with named robots may lie; `packages`:
/// where the files of the description may lie; `inertia`: "plausible" or "file".
#[pyfunction]
fn pack_robot(
    py: Python<'_>,
    robot: String,
    folders: Vec<PathBuf>,
    packages: Vec<PathBuf>,
    inertia: &str,
) -> PyResult<(String, Vec<String>, Option<f64>)> {
    let reading = reading(packages, inertia)?;
    let packed = py.detach(|| sandgait::cli::pack_robot(&robot, &folders, &reading));
    packed.map(|packed| (packed.text, packed.notes, packed.dt)).map_err(|error| errors::raise(&error))
}

/// Is this option `robot` a description that must be packed, and not a robot that every server knows?
#[pyfunction]
fn is_description(robot: &str) -> bool {
    sandgait::cli::is_description(robot)
}

/// The sheet of `sandgait robot --check` as JSON, with notes on the description.
#[pyfunction]
fn check_robot(
    py: Python<'_>,
    robot: String,
    ground: Option<String>,
    folders: Vec<PathBuf>,
    packages: Vec<PathBuf>,
    inertia: &str,
) -> PyResult<(String, Vec<String>)> {
    let reading = reading(packages, inertia)?;
    let sheet = py.detach(|| sandgait::cli::check_robot(&robot, ground.as_deref(), &folders, &reading));
    sheet.map_err(|error| errors::raise(&error))
}

/// How a description is read.
fn reading(packages: Vec<PathBuf>, inertia: &str) -> PyResult<Reading> {
    let inertia = inertia.parse().map_err(|error| errors::raise(&error))?;
    Ok(Reading { packages, inertia })
}

/// The heights of a CSV or NPY as one text.
#[pyfunction]
fn pack_heights(py: Python<'_>, path: std::path::PathBuf) -> PyResult<String> {
    py.detach(|| sandgait::cli::pack_heights(&path)).map_err(|error| errors::raise(&error))
}

/// What a message says of an unknown name: the known name that may be meant, and all known names.
#[pyfunction]
fn unknown_name(name: &str, known: Vec<String>) -> String {
    sandgait::error::unknown_name(name, &known)
}

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::bodies::{Bodies, JointSand, Sand, closed_surface};
    #[pymodule_export]
    use super::check_robot;
    #[pymodule_export]
    use super::errors::StatusError;
    #[pymodule_export]
    use super::is_description;
    #[pymodule_export]
    use super::local::{Local, check_camera};
    #[pymodule_export]
    use super::main;
    #[pymodule_export]
    use super::pack_heights;
    #[pymodule_export]
    use super::pack_robot;
    #[pymodule_export]
    use super::process::threads;
    #[pymodule_export]
    use super::remote::{Request, Response, Stream, close_session, create_session, describe_server, rollout};
    #[pymodule_export]
    use super::studies::{option_words, study};
    #[pymodule_export]
    use super::tables::describe;
    #[pymodule_export]
    use super::train::{describe_policy, mirror, train};
    #[pymodule_export]
    use super::unknown_name;
    #[pymodule_export]
    const MOST_ENVIRONMENTS: usize = sandgait::session::MOST_ENVIRONMENTS;
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
