//! Ways to drive one hip a leg: what an action of HexapodGait means.

use super::clock::Clock;
use super::locomotion::CONTROL_RATE;
use super::spec::Column;
use super::task::Setup;
use crate::sim::State;
use crate::sim::engine::Command;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Fastest a servo's reference moves [rad/s]: 5 Hz, the highest stride frequency of Li et al. 2012. The limit is the
/// same for every way of driving, so that gaits can be compared.
pub const TOP_SPEED: f64 = 5.0 * TAU;

/// The keyword `control`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Control {
    /// The speed of each hip's reference.
    HipSpeed,
    /// The angle each hip's reference goes to.
    HipTarget,
    /// The torque of each hip; the servo does nothing.
    Torque,
    /// A gait as parameters; see [`super::clock`].
    Clock,
}

impl Control {
    /// As the keyword has them.
    pub const NAMES: [&'static str; 4] = ["hip_speed", "hip_target", "torque", "clock"];
}

/// A way of driving a certain robot.
pub struct Driver {
    control: Control,
    /// Torque at action 1 [N·m].
    torque_limit: f64,
    joints: Vec<String>,
    clock: Clock,
}

impl Driver {
    pub fn new(control: Control, setup: &Setup) -> Self {
        let robot = &setup.model.robot;
        let (torque_limit, clock) = (setup.options.torque_limit, Clock::new(robot));
        Self { control, torque_limit, joints: robot.joint_names(), clock }
    }

    /// What an action is, for the task's summary.
    pub fn summary(&self) -> &'static str {
        match self.control {
            Control::HipSpeed => "hip speeds as fractions of 5 Hz",
            Control::HipTarget => "hip angles as fractions of half a turn",
            Control::Torque => "hip torques as fractions of torque_limit",
            Control::Clock => "the parameters of a two-speed clock",
        }
    }

    /// What each number of an action moves.
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

    /// What the servos do under `action`.
    pub fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        let hips = action.iter().zip(&state.references).zip(&mut command.rates);
        match self.control {
            Control::HipSpeed => hips.for_each(|((a, _), rate)| *rate = f64::from(*a) * TOP_SPEED),
            Control::HipTarget => {
                hips.for_each(|((a, reference), rate)| *rate = toward(f64::from(*a) * PI, *reference))
            }
            Control::Torque => {
                // Without gains the reference moves nothing; it follows the hip so that it stays near.
                let angles = state.angles.iter().zip(&state.references).zip(&mut command.rates);
                angles.for_each(|((angle, reference), rate)| *rate = (angle - reference) * CONTROL_RATE);
                let torques = action.iter().zip(&mut command.torques);
                torques.for_each(|(a, torque)| *torque = f64::from(*a) * self.torque_limit);
            }
            Control::Clock => self.clock.command(action, state, command),
        }
    }
}

/// Speed [rad/s] that takes a reference to `target` [rad] by the shortest way within a control step, no faster than
/// [`TOP_SPEED`].
pub fn toward(target: f64, reference: f64) -> f64 {
    (wrapped(target - reference) * CONTROL_RATE).clamp(-TOP_SPEED, TOP_SPEED)
}

/// An angle [rad] less its whole turns, in [−π, π).
pub fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
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

    /// Half a degree over the top is one degree away from half a degree before it, and speed has its limit.
    #[test]
    fn references_go_by_the_shortest_way() {
        let degree = PI / 180.0;
        assert!((toward(-179.5 * degree, 179.5 * degree) - degree * CONTROL_RATE).abs() < 1e-9);
        assert!((toward(0.1 * degree, 0.3 * degree) + 0.2 * degree * CONTROL_RATE).abs() < 1e-9);
        assert_eq!(toward(2.0, 0.0), TOP_SPEED);
        assert_eq!(toward(2.0, 5.0), -TOP_SPEED);
        // References that lag by whole turns are no further away.
        assert!((toward(0.1, -2.0 * TAU) - 0.1 * CONTROL_RATE).abs() < 1e-9);
    }
}
