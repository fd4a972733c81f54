//! Ways to drive one hip a leg: what an action of HexapodGait means.

use super::clock::Clock;
use super::locomotion::CONTROL_RATE;
use super::options::Control;
use super::reference::{TOP_SPEED, toward};
use super::spec::Column;
use super::task::Setup;
use crate::sim::State;
use crate::sim::engine::Command;
use std::f64::consts::PI;

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
