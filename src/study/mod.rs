//! Studies: computations without a session, each declared once.
//!
//! A struct with clap's derive is a study: its fields are the arguments, with their defaults, units and help. `check` makes
//! the work of it, and the work makes a [`StudyResult`]. A study is a file here and a row of [`STUDIES`]. From both follow
//! the command (`cli::study`), the call of the service (`rpc Study`), the function in Python ([`python`]) and the page of
//! the reference ([`page`]).
//!
//! ```text
//!  command line ─┐                     read: the files that the arguments name, on the user's machine
//!  Python ───────┼──▶ words ──▶ study ──▶ Inputs ──▶ check ──▶ StudyWork ──▶ StudyResult: tables and files
//!  rpc Study ────┘   (parse)               (or as they were sent)
//! ```
//!
//! * [`declare`]: what a study is; [`inputs`]: the files that it gets; [`result`]: tables and files that it gives.
//! * [`arguments`]: types of arguments that several studies have; [`options`]: options of a task.
//! * [`trained`]: the task of a learnt policy; [`trials`]: motions of a body.
//! * [`about`]: a study's arguments as data, for [`page`] and [`python`]; [`refusal`]: wrong arguments in one line;
//!   [`layout`]: texts that fit a terminal.

use sandgait_base::{error, parallel, progress};
use sandgait_env as env;
use sandgait_number as number;
use sandgait_sand as sand;
use sandgait_sim as sim;
use sandgait_table as table;
use sandgait_train as train;
use sandgait_view as view;

pub mod about;
pub mod arguments;
mod calibrate;
pub mod declare;
mod diagnose;
mod evaluate;
pub mod inputs;
mod intrude;
pub mod layout;
pub mod options;
pub mod page;
pub mod python;
pub mod refusal;
mod reproduce;
pub mod result;
mod sweep;
pub mod trained;
mod trials;
mod validate;
mod walk;

pub use declare::{AnyStudy, Study, StudyEntry, StudyWork};
pub use inputs::{Content, Inputs};
pub use result::{ColumnValues, StudyColumn, StudyFile, StudyResult, StudyTable};

use crate::error::{Error, Result};

/// All studies.
pub static STUDIES: [StudyEntry; 8] = [
    StudyEntry::of::<walk::Walk>(),
    StudyEntry::of::<intrude::Intrude>(),
    StudyEntry::of::<sweep::Sweep>(),
    StudyEntry::of::<evaluate::Evaluate>(),
    StudyEntry::of::<diagnose::Diagnose>(),
    StudyEntry::of::<calibrate::Calibrate>(),
    StudyEntry::of::<reproduce::Reproduce>(),
    StudyEntry::of::<validate::Validate>(),
];

/// The study of this name.
pub fn named(name: &str) -> Result<&'static StudyEntry> {
    let known: Vec<&str> = STUDIES.iter().map(|study| study.name).collect();
    STUDIES.iter().find(|study| study.name == name).ok_or_else(|| Error::unknown("study", name, &known))
}
