//! The start of a training for a robot with six or more legs: the policy first imitates a plain gait of the robot
//! ([`GaitPrior`]). The gait acts, with the policy's exploration noise, so that the policy also learns the way back to
//! it; the critic learns its returns. Afterwards nothing holds the policy to it.

use super::settings::Hyperparameters;
use crate::env::Task;
use crate::env::legged::LeggedVelocity;
use crate::env::legged::prior::GaitPrior;
use crate::env::registry::Blueprint;
use crate::env::spec::CONTROL_RATE;
use crate::error::Result;

/// Names of the observation's columns with the command.
const COMMANDS: [&str; 3] = ["commanded lin_vel_x", "commanded lin_vel_y", "commanded ang_vel_yaw"];
/// Part of a stride by which the gaits of neighbouring environments differ: the golden ratio, whose multiples spread evenly.
const APART: f64 = 0.618_033_988_749_895;

/// The gait that a policy imitates.
pub struct Teacher {
    pub prior: GaitPrior,
    /// Columns of the observation with the command: forward, to the left, yaw.
    columns: [usize; 3],
}

impl Teacher {
    /// None: the settings or the robot have no such start.
    pub fn of(blueprint: &Blueprint, settings: &Hyperparameters) -> Result<Option<Self>> {
        let (spec, task) = (blueprint.task.spec(), &blueprint.task);
        if spec.id != LeggedVelocity::ID || settings.gait_prior == 0 {
            return Ok(None);
        }
        let prior = GaitPrior::of(task.model(), task.option("action_scale").as_f64())?;
        let at = |name: &str| spec.observation.iter().position(|c| c.name == name).unwrap_or(0);
        Ok(prior.map(|prior| Self { prior, columns: COMMANDS.map(at) }))
    }

    /// Fills `action` with the gait's action in control step `step` of the training, for environment `index`, which has
    /// this observation.
    pub fn act(&self, observation: &[f32], step: u64, index: usize, action: &mut [f32]) {
        let command = self.columns.map(|k| f64::from(observation[k]));
        let phase = self.prior.stride.frequency * step as f64 / CONTROL_RATE + APART * index as f64;
        self.prior.action(command, phase.fract(), action);
    }

    /// What the training says of it.
    pub fn note(&self, steps: u64, found: bool) -> String {
        let [x, y, yaw] = self.prior.speeds();
        let commands = if found {
            format!(
                "commands are at most {x:.2} m/s forward, {y:.2} m/s to the side and {yaw:.2} rad/s, which it reaches \
                     on this ground (--option max_velocity=[x,y,yaw] sets others)"
            )
        } else {
            "commands are those of the options".to_owned()
        };
        format!(
            "the policy imitates a plain gait of {:.1} strides a second for {:.2} M steps (--set gait_prior=0: from nothing); {commands}",
            self.prior.stride.frequency,
            steps as f64 / 1e6
        )
    }
}
