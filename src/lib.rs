//! sandgait: batched reinforcement-learning environments of legged robots on sand.
//!
//! Dependencies go one way: [`service`] → [`session`] → [`pool`] → [`policy`] → [`env`] → [`sim`] → [`sand`]. No crate
//! uses one that is before it in this list.
pub mod cli;

pub use sandgait_base::{Error, Result, error, files, parallel, progress, student};
pub use {
    sandgait_bench as bench, sandgait_bodies as bodies, sandgait_calibrate as calibrate, sandgait_client as client,
    sandgait_diagnose as diagnose, sandgait_env as env, sandgait_evaluate as evaluate, sandgait_number as number,
    sandgait_plot as plot, sandgait_policy as policy, sandgait_pool as pool, sandgait_reproduce as reproduce,
    sandgait_robots as robots, sandgait_sand as sand, sandgait_service as service, sandgait_session as session,
    sandgait_sim as sim, sandgait_study as study, sandgait_sweep as sweep, sandgait_table as table,
    sandgait_train as train, sandgait_validate as validate, sandgait_view as view,
};

// Examples call the command line as a user of this crate would.
extern crate self as sandgait;
