//! The start of a training for a robot with six or more legs: the policy first imitates a plain gait of the robot
//! ([`GaitPrior`]). The gait acts, with the policy's exploration noise, so that the policy also learns the way back to
//! it; the critic learns its returns. Afterwards nothing holds the policy to it.

use super::settings::Hyperparameters;
use crate::env::Task;
use crate::env::legged::LeggedVelocity;
use crate::env::legged::columns::CLOCK;
use crate::env::legged::prior::GaitPrior;
use crate::env::registry::Blueprint;
use crate::error::Result;
use serde_json::{Value, json};
use std::f64::consts::TAU;

/// Names of the observation's columns with the command.
const COMMANDS: [&str; 3] = ["commanded lin_vel_x", "commanded lin_vel_y", "commanded ang_vel_yaw"];
/// Options with the frequency of the observed clock, with the greatest speeds of commands and with the width of the tracking
/// terms, and the reward term for long steps.
const CLOCK_RATE: &str = "gait_clock";
const SPEEDS: &str = "max_velocity";
const SIGMA: &str = "tracking_sigma";
const AIR_TIME: &str = "feet_air_time";
/// σ of the tracking terms of a robot with a clock: our choice. They take the mean velocity of a stride, which does not sway, so
/// they may be narrow; and at slow commands, a small drift is a large part of the command. docs/learning_hexapods.md compares
/// it with the default.
const NARROW: f64 = 0.03;

/// The plain gait of the robot of LeggedVelocity in `blueprint`; None: it has fewer than six legs, or an odd number.
pub fn plain_gait(blueprint: &Blueprint) -> Result<Option<GaitPrior>> {
    let task = &blueprint.task;
    let number = |name: &str| task.option(name).as_f64();
    GaitPrior::of(task.model(), number("action_scale"), number(CLOCK_RATE))
}

/// For a robot with a plain gait, sets in `options` of LeggedVelocity the clock of the observation to the gait's strides,
/// the greatest speeds of commands to what the gait reaches, narrow tracking terms, and the weight of the term for long steps
/// to 0: its threshold is made for the strides of four legs, and on six it makes standing the best gait. Options that are given
/// stay; values in `kept`, the options of a training that goes on, come before the gait's. Says whether it set speeds.
pub fn suit(options: &mut Value, kept: &Value) -> Result<bool> {
    let Some(prior) = plain_gait(&Blueprint::new(LeggedVelocity::ID, options.clone())?)? else { return Ok(false) };
    let old = |name: &str| Some(kept[name].clone()).filter(|value| !value.is_null());
    if options[CLOCK_RATE].is_null() {
        options[CLOCK_RATE] = old(CLOCK_RATE).unwrap_or_else(|| json!(prior.stride.frequency));
    }
    if options[SIGMA].is_null() {
        options[SIGMA] = old(SIGMA).unwrap_or_else(|| json!(NARROW));
    }
    if options["rewards"][AIR_TIME].is_null() {
        let mut rewards = options["rewards"].as_object().cloned().unwrap_or_default();
        rewards.insert(AIR_TIME.into(), json!(0.0));
        options["rewards"] = Value::Object(rewards);
    }
    let given = |name: &str| options["commands"].get(name).is_some_and(|range| !range.is_null());
    if !options[SPEEDS].is_null() || ["lin_vel_x", "lin_vel_y", "ang_vel_yaw"].into_iter().any(given) {
        return Ok(false);
    }
    options[SPEEDS] = old(SPEEDS).unwrap_or_else(|| json!(prior.speeds()));
    Ok(true)
}

/// The gait that a policy imitates.
pub struct Teacher {
    pub prior: GaitPrior,
    /// Columns of the observation with the command: forward, to the left, yaw.
    columns: [usize; 3],
    /// Columns with sine and cosine of the clock.
    clock: [usize; 2],
}

impl Teacher {
    /// None: the settings, the robot or the observation, which needs a clock, have no such start.
    pub fn of(blueprint: &Blueprint, settings: &Hyperparameters) -> Result<Option<Self>> {
        let spec = blueprint.task.spec();
        if spec.id != LeggedVelocity::ID || settings.gait_prior == 0 {
            return Ok(None);
        }
        let at = |name: &str| spec.observation.iter().position(|c| c.name == name);
        let ([Some(sine), Some(cosine)], Some(x)) = (CLOCK.map(at), at(COMMANDS[0])) else { return Ok(None) };
        let columns = COMMANDS.map(|name| at(name).unwrap_or(x));
        Ok(plain_gait(blueprint)?.map(|prior| Self { prior, columns, clock: [sine, cosine] }))
    }

    /// Fills `action` with the gait's action for a robot that has this observation.
    pub fn act(&self, observation: &[f32], action: &mut [f32]) {
        let number = |k: usize| f64::from(observation[k]);
        let [sine, cosine] = self.clock.map(number);
        self.prior.action(self.columns.map(number), sine.atan2(cosine) / TAU, action);
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
            "the policy imitates a plain gait of {:.1} strides a second for {:.2} M steps and observes a clock of them (--set gait_prior=0: neither); \
             unless they are given, reward term feet_air_time is 0 and tracking_sigma {NARROW}; {commands}",
            self.prior.stride.frequency,
            steps as f64 / 1e6
        )
    }
}
