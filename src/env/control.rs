//! Control modes for robots with one hip a leg: the meaning of an action of HexapodGait.

use super::clock::Clock;
use super::options::OptionValue;
use super::reference::{TOP_SPEED, toward};
use super::spec::{CONTROL_RATE, Column};
use crate::sim::engine::Command;
use crate::sim::{MemoryCount, Robot, State};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// The values of the keyword `control`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Control {
    /// An action sets the speed of each hip's reference.
    HipSpeed,
    /// An action sets the angle to which each hip's reference moves.
    HipTarget,
    /// An action sets the torque of each hip; the servo is off.
    Torque,
    /// A gait as parameters; see [`super::clock`].
    Clock,
}

impl Control {
    /// The values as text.
    pub const NAMES: [&'static str; 4] = ["hip_speed", "hip_target", "torque", "clock"];
}

impl OptionValue for Control {
    fn count_memory(&self, _count: &mut MemoryCount) {}
}

/// A control mode with the numbers of a certain robot.
pub struct Driver {
    control: Control,
    /// Torque at action 1 [N·m].
    torque_limit: f64,
    joints: Vec<String>,
    clock: Clock,
}

impl Driver {
    pub fn new(control: Control, robot: &Robot, torque_limit: f64) -> Self {
        Self { control, torque_limit, joints: robot.joint_names(), clock: Clock::new(robot) }
    }

    /// The action in words, for the task's summary.
    pub fn summary(&self) -> &'static str {
        match self.control {
            Control::HipSpeed => "hip speeds as fractions of 5 Hz",
            Control::HipTarget => "hip angles as fractions of half a turn",
            Control::Torque => "hip torques as fractions of torque_limit",
            Control::Clock => "the parameters of a two-speed clock",
        }
    }

    /// The meaning of each action component.
    pub fn labels(&self) -> Vec<String> {
        match self.control {
            Control::Clock => self.clock.labels(&self.joints),
            _ => self.joints.clone(),
        }
    }

    /// The action's table.
    pub fn columns(&self) -> Vec<Column> {
        let each = |name| Column::each(&self.joints, name, "1", 1.0);
        match self.control {
            Control::HipSpeed => each("target hip speed / 5 Hz"),
            Control::HipTarget => each("target hip angle / π"),
            Control::Torque => each("hip torque / torque_limit"),
            Control::Clock => self.clock.columns(&self.joints),
        }
    }

    /// The servos' command under `action`.
    pub fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        let hips = action.iter().zip(&state.references).zip(&mut command.rates);
        match self.control {
            Control::HipSpeed => hips.for_each(|((a, _), rate)| *rate = f64::from(*a) * TOP_SPEED),
            Control::HipTarget => {
                hips.for_each(|((a, reference), rate)| *rate = toward(f64::from(*a) * PI, *reference))
            }
            Control::Torque => {
                // Without servo gains the reference has no effect. It follows the hip's angle, so that reference and angle stay close.
                let angles = state.angles.iter().zip(&state.references).zip(&mut command.rates);
                angles.for_each(|((angle, reference), rate)| *rate = (angle - reference) * CONTROL_RATE);
                let torques = action.iter().zip(&mut command.torques);
                torques.for_each(|(a, torque)| *torque = f64::from(*a) * self.torque_limit);
            }
            Control::Clock => self.clock.command(action, state, command),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_the_keywords() {
        use Control::*;
        let all = [HipSpeed, HipTarget, Torque, Clock].map(|c| serde_json::to_value(c).unwrap());
        assert_eq!(all, Control::NAMES.map(serde_json::Value::from));
    }
}
