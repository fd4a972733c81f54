//! The curriculum of LeggedVelocity: an episode's difficulty follows from how well the same environment's robot followed
//! its commands in the episode before, as in legged_gym (`_update_terrain_curriculum`).
//!
//! The level is in the episode's `TaskState`, and `Task::begin_after` gets that of the episode before. So it is in snapshots,
//! depends on no neighbour, and works with every learner.

use crate::options;
use crate::sim::tree::forces::support;
use crate::sim::{Model, State};
use serde::{Deserialize, Serialize};

/// Depth to which the feet of a standing robot sink at level 0, as a part of the legs' length: our choice. The robot's
/// own servos give way by a twentieth of this length (`tree::gains`), so sand that gives way less is almost like hard
/// ground.
const FIRM: f64 = 0.02;
/// Speed of sinking at which the sand's supporting force is computed, in units of √(gℓ), ℓ the legs' length: our choice,
/// slow; the force hardly depends on it.
const SLOW: f64 = 1e-3;
/// Largest factor on the sand's stress: our choice. Robots with pointed feet need large factors.
pub const MOST_EASE: f64 = 200.0;

options! {
    /// When levels rise and fall. Our choice, because a robot with an error of 0.4 certainly walks; a robot that stands
    /// still has an error of 1, or less under slow commands. By default commands have their full size at all levels,
    /// because under slow commands a robot would get most of the reward by standing still. Ten rises take a robot from
    /// level 0 to level 1.
    #[derive(Copy, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Curriculum {
        level: f64 = 0.0, [0.0, 1.0], "level of an environment's first episode, from 0 (easiest) to 1 (the task itself)";
        step: f64 = 0.1, [1e-3, 1.0], "change of the level from an episode to the next";
        rise: f64 = 0.4, [0.0, 10.0], "largest mean error of an episode after which the level rises";
        fall: f64 = 0.7, [0.0, 10.0], "mean error from which on the level falls, as after a fall of the robot";
        commands: f64 = 1.0, [0.0, 1.0], "share of the commands at level 0";
    }
}

/// How well the robot has followed its commands in an episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Followed {
    /// Sum over steps of the velocity under the present command: forward, to the left [m/s], yaw [rad/s]. Steps at the
    /// beginning of the command are left out.
    pub sum: [f64; 3],
    /// Number of steps in `sum`.
    pub steps: u32,
    /// Sum of the errors of earlier commands, and their number.
    pub error: f64,
    pub commands: u32,
    pub fell: bool,
}

impl Followed {
    /// For snapshots: can an episode have reached these values?
    pub fn is_sound(&self) -> bool {
        self.sum.iter().chain([&self.error]).all(|x| x.is_finite()) && self.error >= 0.0
    }

    /// Adds a step's velocity.
    pub fn add(&mut self, velocity: [f64; 3]) {
        self.sum.iter_mut().zip(velocity).for_each(|(sum, v)| *sum += v);
        self.steps += 1;
    }

    /// Ends `command`. Its error counts if steps were added under it. Velocities and commands are first divided by
    /// `unit`, the ends of the commands' default ranges. The error of the mean velocity is then divided by the length
    /// of the command, or by [`LEAST`] if the command is shorter.
    pub fn end(&mut self, command: [f64; 3], unit: [f64; 3]) {
        if self.steps > 0 {
            let n = f64::from(self.steps);
            let norm = |v: [f64; 3]| (0..3).map(|k| (v[k] / unit[k]).powi(2)).sum::<f64>().sqrt();
            let off: [f64; 3] = std::array::from_fn(|k| self.sum[k] / n - command[k]);
            self.error += norm(off) / norm(command).max(LEAST);
            self.commands += 1;
        }
        (self.sum, self.steps) = ([0.0; 3], 0);
    }
}

/// An error is divided by the length of its command, but at least by this, in units of the ends of the commands'
/// default ranges. Our choice, because an error relative to a very slow command would have no bound.
const LEAST: f64 = 0.4;

impl Curriculum {
    /// The level after an episode.
    pub fn next(&self, level: f64, followed: &Followed) -> f64 {
        let error = followed.error / f64::from(followed.commands.max(1));
        let change = match followed.fell {
            true => -self.step,
            false if followed.commands == 0 => 0.0,
            false if error <= self.rise => self.step,
            false if error >= self.fall => -self.step,
            false => 0.0,
        };
        (level + change).clamp(0.0, 1.0)
    }
}

/// The factor on the sand's stress with which the model's standing robot sinks by [`FIRM`]; at least 1, at most [`MOST_EASE`].
pub fn ease(model: &Model) -> f64 {
    let Some(tree) = &model.tree else { return 1.0 };
    if !model.has_sand() {
        return 1.0;
    }
    let (angles, length) = (&tree.stance.angles, tree.stance.leg_length);
    let mut state = State::at_rest(tree.height_over(angles, |x, y| model.surface_height(x, y)), angles);
    state.position[2] -= FIRM * length;
    state.velocity[2] = -SLOW * (model.gravity_size() * length).sqrt();
    let support = support(model, &state);
    if support > 0.0 { (model.weight() / support).clamp(1.0, MOST_EASE) } else { MOST_EASE }
}
