//! Options of every task whose robot walks on identical legs, the model built from them, and how episodes begin.

use super::locomotion::{MAX_COMMAND, MAX_TURN, Weights};
use super::options::RobotName;
use super::random::Random;
use super::task::{Setup, TaskState};
use crate::error::{Error, Result};
use crate::options;
use crate::sand::{Law, Medium, SandDescription};
use crate::sim::engine::EngineKind;
use crate::sim::model::Scene;
use crate::sim::{Model, Robot, State};
use std::f64::consts::PI;

/// Longest episode [control steps]: our choice, 5.6 hours, far above the 10 to 20 s of the tasks.
pub const MAX_STEPS: f64 = 1e6;

options! {
    /// Options of a robot that walks. `torque_limit`: our choice, some six times the rms torque of a 2 Hz walk. The
    /// other numbers are our choice, too: commands are the speeds of an L-leg at 1 to 3 Hz, noise makes starts differ,
    /// and an episode takes 10 s.
    pub struct Walking {
        robot: RobotName = "xplorer".into(), "built-in robot: xplorer or xplorer18";
        engine: EngineKind = EngineKind::Lanes, "engine that integrates the motion: lanes or rapier";
        law: Law = Law::Li2013, "resistive force law: li2013, penetration-drag-1d or agarwal2023";
        dt: f64 = Scene::DEFAULT_DT, "time step [s], which divides the control period; 1 ms, with engine rapier 0.5 ms";
        torque_limit: f64 = 0.05, [1e-4, 1e3], "largest servo torque [N·m]";
        command: [f64; 2] = [0.1, 0.4], [-MAX_COMMAND, MAX_COMMAND], reset, "range [low, high] of the commanded speed [m/s]";
        turn: [f64; 2] = [0.0, 0.0], [-MAX_TURN, MAX_TURN], reset, "range [low, high] of the commanded yaw speed [rad/s]";
        angle_noise: f64 = 0.2, [0.0, PI], "largest difference of the initial joint angles from the task's initial pose, uniformly distributed [rad]";
        weights: Weights = Weights::default(), "weight of each reward term";
        leg: String = "L".into(), reset, "leg shape: L, revL, C, revC, flat or xi=DEGREES";
        medium: String = Medium::DEFAULT.into(), reset, "sand: a medium's name, zeta=VALUE or mu=VALUE,rho=VALUE";
        sand: String = String::new(), "text of a sand.toml, for example from a diagnosis (in Python its path); it replaces medium and law";
        memory: bool = false, "sand that was moved stays moved: prints, furrows and heaps, and sand that is pressed gets stronger (docs/memory.md)";
        slope_deg: f64 = 0.0, [-Scene::MAX_SLOPE_DEG, Scene::MAX_SLOPE_DEG], reset, "slope of the surface [°]; a positive slope rises toward +x";
        payload: f64 = 0.0, [0.0, Scene::MAX_PAYLOAD], reset, "extra mass at the base's centre [kg]";
        max_episode_steps: u32 = 500, [1.0, MAX_STEPS], "number of control steps after which an episode is truncated";
    }
}

impl Walking {
    /// Ranges of the commands forward, to the left [m/s] and yaw [rad/s].
    pub fn command_ranges(&self) -> [[f64; 2]; 3] {
        [self.command, [0.0; 2], self.turn]
    }

    /// Robot, sand and slope; without `servos` torques alone drive the robot's joints.
    pub fn model(&self, servos: bool) -> Result<Model> {
        if self.robot.name().ends_with(".toml") {
            return Err(Error::unknown("robot", self.robot.name(), &Robot::names()));
        }
        let mut robot = Robot::load(self.robot.name())?.with_leg_shape(&self.leg)?;
        robot.servo.torque_limit = Some(self.torque_limit);
        // The observation does not contain the servos' lag, so the lag must stay small.
        robot.servo.anti_windup = true;
        if !servos {
            (robot.servo.kp, robot.servo.kd) = (0.0, 0.0);
        }
        let mut scene = Scene::flat(Medium::named(&self.medium)?);
        (scene.law, scene.slope_deg, scene.dt, scene.payload) = (self.law, self.slope_deg, self.dt, self.payload);
        set_sand(&mut scene, &self.sand)?;
        if self.memory {
            if self.engine != EngineKind::Lanes {
                let reason = format!("engine {} has no sand with memory; lanes has", self.engine.name());
                return Err(Error::invalid("memory", reason));
            }
            scene.remember(&robot);
        }
        Model::new(&robot, &scene)
    }
}

/// Replaces the sand of `scene` by that of a sand.toml, if its text is not empty.
pub fn set_sand(scene: &mut Scene, text: &str) -> Result<()> {
    if !text.is_empty() {
        scene.set_sand(&SandDescription::from_toml(text)?);
    }
    Ok(())
}

/// The robot at rest on the surface, with joints near their start positions and within their stops, and commands drawn from the options' ranges.
pub fn begin(setup: &Setup<Walking>, random: &mut Random) -> (State, TaskState) {
    let Walking { angle_noise, command, turn, .. } = *setup.options;
    let mut angles = setup.model.tripod_angles();
    angles.iter_mut().for_each(|a| *a += random.uniform(-angle_noise, angle_noise));
    for (angle, body) in angles.iter_mut().zip(setup.model.legs.iter().flatten()) {
        *angle = body.range.map_or(*angle, |[low, high]| angle.clamp(low, high));
    }
    let [speed, turn] = [command, turn].map(|[low, high]| random.uniform(low, high));
    let task_state = TaskState { speed, turn, ..TaskState::default() };
    (State::at_rest(setup.model.standing_height(&angles), &angles), task_state)
}
