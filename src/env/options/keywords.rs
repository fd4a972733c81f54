//! Which keywords there are, and which task takes which.

use crate::error::{Error, Result};

/// What each keyword means, in the order of [`super::TaskOptions`].
pub const OPTION_HELP: [(&str, &str); 25] = [
    ("robot", "built-in robot; for LeggedVelocity also a packed file (Python: its path)"),
    ("engine", "engine that integrates the motion"),
    ("law", "resistive force law: li2013, penetration-drag-1d or agarwal2023"),
    ("dt", "time step [s]; 1 ms, with engine rapier 0.5 ms"),
    ("torque_limit", "largest servo torque [N·m]"),
    ("command", "range [low, high] the commanded speed is drawn from [m/s]"),
    ("turn", "range [low, high] the commanded yaw speed is drawn from [rad/s]"),
    ("angle_noise", "initial joint angles are uniform within ± this around the task's own [rad]"),
    ("weights", "weight of each reward term"),
    ("leg", "leg shape: L, revL, C, revC, flat or xi=DEGREES"),
    ("medium", "sand: a medium's name, zeta=VALUE or mu=VALUE,rho=VALUE"),
    ("sand", "a sand.toml, as a diagnosis writes it: replaces medium and law (Python: its path)"),
    ("slope_deg", "surface rises toward +x [°]"),
    ("payload", "extra mass at the base's centre [kg]"),
    ("max_episode_steps", "control steps until an episode is truncated"),
    ("control", "what an action is: hip_speed, hip_target, torque or clock"),
    (
        "rocks",
        "obstacles of an episode: count, ranges [low, high] of size and step_height [m], dynamic_fraction, density [kg/m³], friction, field: its [length, width] in m",
    ),
    (
        "randomize",
        "ranges [low, high] that an episode draws from: factors zeta and torque_limit, patch_length [m], added slope_deg [°] and payload [kg], footprint κ, turning_point [m]",
    ),
    ("difficulty", "how much of randomize: 0 nothing, 1 all"),
    (
        "stroke",
        "carriage_speed [m/s], height of the hip over the sand [m], start: angles [hip, knee] in rad, lift: least mean lift [N], lift_weight and exit_weight of the penalties",
    ),
    ("ground", "rigid, mixed (slabs of hard ground in loose poppy seeds), or the sand's medium as in `medium`"),
    (
        "commands",
        "ranges [low, high] of lin_vel_x, lin_vel_y [m/s] and ang_vel_yaw [rad/s], drawn anew every resampling_time [s]",
    ),
    ("rewards", "weight of each reward term, a second"),
    (
        "domain_rand",
        "ranges [low, high] that an episode draws from: factors friction_range, sand_range, motor_strength_range; added_mass_range, a share of the mass; push_interval [s], 0: none; max_push_vel_xy [m/s]. None: nothing is drawn",
    ),
    ("action_scale", "what an action of 1 adds to a joint's default position [rad]"),
];

/// Keywords of every task.
const COMMON: [&str; 3] = ["law", "dt", "max_episode_steps"];

/// Keywords of every robot that walks, beyond [`COMMON`].
macro_rules! walking {
    ($($own:literal),*) => {
        &["robot", "engine", "torque_limit", "command", "turn", "angle_noise", "weights", "leg", "medium", "sand",
          "slope_deg", "payload", $($own),*]
    };
}

/// Which keywords a task takes.
pub struct Keywords {
    /// The task's id.
    pub task: &'static str,
    /// Beyond [`COMMON`].
    own: &'static [&'static str],
}

pub const GAIT: Keywords = Keywords { task: "sandgait/HexapodGait-v1", own: walking!("control") };
pub const LEGS: Keywords = Keywords { task: "sandgait/HexapodLegs-v1", own: walking!() };
pub const ROCKS: Keywords = Keywords { task: "sandgait/HexapodRocks-v1", own: walking!("control", "rocks") };
pub const TERRAIN: Keywords =
    Keywords { task: "sandgait/HexapodTerrain-v1", own: walking!("control", "randomize", "difficulty") };
pub const STROKE: Keywords =
    Keywords { task: "sandgait/LegStroke-v0", own: &["angle_noise", "medium", "sand", "stroke"] };
pub const LEGGED: Keywords = Keywords {
    task: "sandgait/LeggedVelocity-v0",
    own: &[
        "robot",
        "angle_noise",
        "sand",
        "slope_deg",
        "payload",
        "ground",
        "commands",
        "rewards",
        "domain_rand",
        "action_scale",
    ],
};

impl Keywords {
    /// Of all tasks.
    pub const ALL: [&'static Self; 6] = [&GAIT, &LEGS, &ROCKS, &TERRAIN, &STROKE, &LEGGED];

    pub fn has(&self, keyword: &str) -> bool {
        COMMON.contains(&keyword) || self.own.contains(&keyword)
    }

    /// Refuses a keyword that the task does not take.
    pub fn check(&self, keyword: &str) -> Result<()> {
        if self.has(keyword) {
            return Ok(());
        }
        let others: Vec<_> = Self::ALL.iter().filter(|k| k.has(keyword)).map(|k| k.task).collect();
        if others.is_empty() {
            let known: Vec<_> = OPTION_HELP.iter().map(|(name, _)| *name).filter(|name| self.has(name)).collect();
            return Err(Error::unknown("option", keyword, &known));
        }
        Err(Error::invalid(keyword, format!("{} has no such option; {} has", self.task, others.join(", "))))
    }
}
