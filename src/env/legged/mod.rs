//! `sandgait/LeggedVelocity-v0`: any legged robot follows commanded velocities forward, sideways and about the vertical, on
//! sand and on hard ground.
//!
//! Observations, actions, rewards and their names follow legged_gym (Rudin, Hoeller, Reist & Hutter, CoRL 2022;
//! `legged_robot.py`) and the velocity tasks of Isaac Lab (Mittal et al. 2023; `velocity_env_cfg.py`).
//!
//! * [`episode`]: what an episode draws and remembers; [`reward`]: the terms.

mod episode;
mod reward;

pub use episode::LeggedEpisode;

use super::ground::Change;
use super::locomotion::CONTROL_RATE;
use super::options::{Commands, DomainRand, Rewards, RobotName, TaskOptions, keywords};
use super::random::Random;
use super::spec::{Column, Spec};
use super::task::{Goal, Setup, Task, Transition};
use crate::error::{Error, Result};
use crate::sim::engine::{Command, EngineKind};
use crate::sim::model::GRAVITY;
use crate::sim::{Model, State};
use reward::Contacts;
use std::sync::Arc;

/// Bounds of the observation; what goes beyond is clipped. Some three times what a falling robot reaches.
const SPEED: f64 = 10.0; // [m/s]
const TURN: f64 = 30.0; // [rad/s]
const JOINT_SPEED: f64 = 100.0; // [rad/s]
const JOINT_OFFSET: f64 = std::f64::consts::TAU; // [rad]

/// Gravity's direction along the base's z axis above which it has fallen: cos 60°. Our choice.
const FALLEN: f64 = -0.5;

/// Time step [s]: our choice, twice that of the hexapods, whose feet turn faster. A trot of the test quadruped went up to 5 % off
/// one at 0.125 ms in sand and 10 % on hard ground; at 1 ms 8 % on hard ground.
const DT: f64 = 2e-3;

const ABOUT: &str = "\
The robot starts in its default pose, joints off by up to `angle_noise`, just over the ground. An action is an offset of each
joint's target from its default position, times `action_scale`; a servo at each joint (the file's gains, or kp = torque limit / 1 rad and kd =
kp / 40 s⁻¹) follows it. Commands are drawn from `commands` at the start and every `resampling_time`; those below 0.2 m/s are
zero. `domain_rand` says what else is drawn for an episode, and how often the base is pushed.

Names and laws of reward terms, their weights, and the order of the observation are those of legged_gym (Rudin et al. 2022) and
of Isaac Lab's velocity tasks; as there, each term counts its weight a second. A foot is in contact when it is in the ground, and a
body collides when it is. Velocities are those of the base link's origin, in the base's frame. Unlike there, observations are not scaled
and a negative sum of rewards is not cut at zero.

An episode terminates when the base has tilted by more than 60° (`bad_orientation`) or, on `rigid` ground, touches it
(`base_contact`); it is truncated after `max_episode_steps`, or when its state can no longer be computed (`diverged`).

On ground with heights (`relief`, or ground `dunes`) an episode begins anywhere; `measure_heights` adds legged_gym's
`measured_heights`, the base's height over 17 × 11 points less 0.5 m, within ± 1 m. A slope's sand is pushed along its own surface.

Speeds beyond about 0.5 m/s of what is in the sand are outside of what resistive force theory was measured for.";

/// The task's keywords before any are given.
pub fn defaults() -> TaskOptions {
    TaskOptions {
        robot: RobotName::TREE.into(),
        engine: EngineKind::Tree,
        dt: DT,
        angle_noise: 0.1,
        max_episode_steps: 1000, // 20 s, as legged_gym
        ground: "poppy-loose".into(),
        commands: Some(Commands::default()),
        rewards: Some(Rewards::default()),
        domain_rand: Some(DomainRand::default()),
        action_scale: Some(0.25),
        ..Default::default()
    }
}

pub struct LeggedVelocity {
    spec: Spec,
    rewards: Rewards,
    /// Default position of each joint [rad].
    angles: Vec<f64>,
    scale: f64,
    /// Are heights observed?
    measures: bool,
}

impl LeggedVelocity {
    pub const ID: &'static str = keywords::LEGGED.task;

    pub fn new(setup: &Setup) -> Result<Self> {
        let options = &setup.options;
        let Some(tree) = &setup.model.tree else {
            return Err(Error::invalid("robot", "is no tree of bodies"));
        };
        if tree.joints() == 0 {
            return Err(Error::invalid("robot", format!("{:?} has no joints", tree.tree.name)));
        }
        let (joints, rewards) = (&setup.model.joint_names(), options.rewards.unwrap_or_default());
        let command =
            |name: &str, unit| Column::new(format!("commanded {name}"), unit, -Commands::MOST, Commands::MOST);
        let measures = options.measure_heights.unwrap_or(false);
        let height = |[x, y]: [f64; 2]| Column::new(format!("measured_heights {x:.1} {y:.1}"), "m", -1.0, 1.0);
        let heights = if measures { measured().map(height).collect() } else { Vec::new() };
        let observation = [
            Column::xyz("base_lin_vel", "m/s", SPEED),
            Column::xyz("base_ang_vel", "rad/s", TURN),
            Column::xyz("projected_gravity", "1", 1.0),
            vec![command("lin_vel_x", "m/s"), command("lin_vel_y", "m/s"), command("ang_vel_yaw", "rad/s")],
            Column::each(joints, "joint_pos off its default", "rad", JOINT_OFFSET),
            Column::each(joints, "joint_vel", "rad/s", JOINT_SPEED),
            Column::each(joints, "last action", "1", 1.0),
            heights,
        ];
        let terms = rewards.terms();
        let mut info: Vec<_> = terms.iter().map(|t| Column::free(format!("reward_{}", t.name), "1")).collect();
        info.extend(FIGURES.map(|(name, unit)| Column::free(name, unit)));
        let spec = Spec {
            id: Self::ID,
            summary: "Any legged robot follows commanded velocities on sand or hard ground; actions are offsets of joint targets."
                .into(),
            observation: observation.concat(),
            action: Column::each(joints, "offset of the target over action_scale", "1", 1.0),
            about: ABOUT,
            reward: terms,
            info,
            max_episode_steps: options.max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        Ok(Self {
            spec,
            rewards,
            angles: tree.stance.angles.clone(),
            scale: options.action_scale.unwrap_or(0.25),
            measures,
        })
    }
}

/// Info columns behind the reward's.
const FIGURES: [(&str, &str); 18] = [
    ("speed", "m/s"),
    ("lin_vel_y", "m/s"),
    ("ang_vel_yaw", "rad/s"),
    ("x_velocity", "m/s"),
    ("command_lin_vel_x", "m/s"),
    ("command_lin_vel_y", "m/s"),
    ("command_ang_vel_yaw", "rad/s"),
    ("feet_in_contact", "1"),
    ("base_height", "m"),
    ("work", "J"),
    ("weight", "N"),
    ("friction", "1"),
    ("sand", "1"),
    ("added_mass", "kg"),
    ("motor_strength", "1"),
    ("bad_orientation", "1"),
    ("base_contact", "1"),
    ("diverged", "1"),
];

/// Gravity's direction, velocity and angular velocity in the base's frame.
fn base(state: &State) -> [[f64; 3]; 3] {
    [[0.0, 0.0, -1.0], state.velocity, state.angular_velocity].map(|v| state.to_body(v))
}

impl Task for LeggedVelocity {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal) {
        let noise = setup.options.angle_noise;
        let angles: Vec<f64> = self.angles.iter().map(|a| a + random.uniform(-noise, noise)).collect();
        let legged = LeggedEpisode::draw(setup, random);
        // What was drawn lies in ranges that were checked: the session's own model is there for what cannot be.
        let model = legged.model(setup).map_or_else(|_| setup.model.clone(), Arc::new);
        // Anywhere on ground that is not flat.
        let size = model.scene.relief.as_ref().map(|r| r.size());
        let at = size.map_or([0.0; 2], |size| size.map(|length| random.uniform(0.0, length)));
        let mut state = State::at_rest(height(&model, &angles, at), &angles);
        (state.position[0], state.position[1]) = (at[0], at[1]);
        state.references.copy_from_slice(&self.angles);
        let [speed, _, turn] = legged.command(&setup.options);
        (state, Goal { speed, turn, model: Some(model), legged: Some(legged), ..Goal::default() })
    }

    fn command(&self, action: &[f32], _state: &State, command: &mut Command) {
        command.targets.clear();
        command.targets.extend(self.angles.iter().zip(action).map(|(a, offset)| a + self.scale * f64::from(*offset)));
    }

    fn walked(&self, setup: &Setup, goal: &mut Goal, state: &State) -> Change {
        let (Some(legged), Some(model)) = (&mut goal.legged, &goal.model) else { return Change::Nothing };
        let push = legged.stepped(&setup.options, &Contacts::of(model, state).feet);
        [goal.speed, _, goal.turn] = legged.command(&setup.options);
        push.map_or(Change::Nothing, Change::Push)
    }

    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]) {
        let [gravity, v, w] = base(state);
        let command = goal.legged.as_ref().map_or([0.0; 3], |l| l.now);
        let offsets = state.angles.iter().zip(&self.angles).map(|(q, default)| q - default);
        let numbers =
            v.into_iter().chain(w).chain(gravity).chain(command).chain(offsets).chain(state.rates.iter().copied());
        let numbers = numbers.map(|x| x as f32).chain(last_action.iter().copied());
        row.iter_mut().zip(numbers).for_each(|(out, x)| *out = x);
        if let (true, Some(model)) = (self.measures, &goal.model) {
            let from = row.len() - measured().count();
            row[from..].iter_mut().zip(measured_heights(model, state)).for_each(|(out, x)| *out = x as f32);
        }
    }

    fn judge(&self, t: &Transition, info: &mut [f32]) -> bool {
        let Some(legged) = &t.goal.legged else { return false };
        let contacts = Contacts::of(t.model, t.after);
        let [gravity, v, w] = base(t.after);
        let fallen = gravity[2] > FALLEN;
        let base_contact = contacts.base && !t.model.has_sand();
        let terminated = !t.diverged && (fallen || base_contact);
        let (rewards, figures) = info.split_at_mut(self.spec.reward.len());
        let terms = reward::terms(t, legged, &contacts, &self.angles, terminated);
        for ((out, term), weight) in rewards.iter_mut().zip(terms).zip(self.rewards.values()) {
            *out = (term * weight * t.period) as f32;
        }
        let flag = |yes: bool| f64::from(u8::from(yes));
        let feet = contacts.feet.iter().filter(|touches| **touches).count();
        let values: [f64; FIGURES.len()] = [
            v[0],
            v[1],
            w[2],
            (t.after.position[0] - t.before.position[0]) / t.period,
            legged.now[0],
            legged.now[1],
            legged.now[2],
            feet as f64,
            t.after.position[2] - t.model.surface_height(t.after.position[0], t.after.position[1]),
            t.after.work - t.before.work,
            t.model.total_mass() * GRAVITY,
            legged.friction,
            legged.sand,
            legged.added_mass,
            legged.motor_strength,
            flag(fallen && !t.diverged),
            flag(base_contact && !t.diverged),
            flag(t.diverged),
        ];
        figures.iter_mut().zip(values).for_each(|(out, x)| *out = x as f32);
        terminated
    }
}

/// Height of the base's origin over `at` at which the lowest point touches the ground [m].
fn height(model: &Model, angles: &[f64], at: [f64; 2]) -> f64 {
    let Some(tree) = &model.tree else { return 0.0 };
    tree.height_over(angles, |x, y| model.surface_height(at[0] + x, at[1] + y))
}

/// Points around the robot whose heights it observes [m]: those of legged_gym (`measured_points_x`, `measured_points_y`),
/// 0.1 m from each other.
const MEASURED: [i32; 2] = [8, 5];

fn measured() -> impl Iterator<Item = [f64; 2]> {
    let [ahead, aside] = MEASURED;
    (-ahead..=ahead).flat_map(move |i| (-aside..=aside).map(move |j| [0.1 * f64::from(i), 0.1 * f64::from(j)]))
}

/// Height of the base's origin over each of them less 0.5 m, as legged_gym has it.
fn measured_heights(model: &Model, state: &State) -> impl Iterator<Item = f64> {
    let [x, y, z] = state.position;
    let ahead = state.rotation();
    let (sin, cos) = ahead[1][0].atan2(ahead[0][0]).sin_cos();
    measured().map(move |[a, b]| {
        let ground = model.surface_height(x + cos * a - sin * b, y + sin * a + cos * b);
        (z - 0.5 - ground).clamp(-1.0, 1.0)
    })
}
