//! `sandgait/LeggedVelocity-v1`: any legged robot follows commanded velocities forward, sideways and about the
//! vertical, on sand and on hard ground.
//!
//! Observations, actions, rewards and their names follow legged_gym (Rudin, Hoeller, Reist & Hutter, CoRL 2022;
//! `legged_robot.py`) and the velocity tasks of Isaac Lab (Mittal et al. 2023; `velocity_env_cfg.py`).
//!
//! * [`options`]: its options; [`draws`]: the ranges that an episode draws from; [`episode`]: the values that an
//!   episode has drawn and updates; [`reward`]: the terms.

pub mod columns;
mod curriculum;
pub mod draws;
pub mod episode;
mod options;
pub mod prior;
mod reward;
pub mod units;

pub use draws::{Commands, DomainRand, MOST_COMMAND, SAND};
pub use options::{ANY, LEGS, LeggedOptions, ReliefOptions};
use options::{driven, legs_alone};
pub use reward::Rewards;
pub use units::Units;

use super::feature::Features;
use super::ground::Change;
use super::random::Random;
use super::spec::{CONTROL_RATE, Column, Spec};
use super::task::{Setup, Task, TaskState, Transition};
use crate::error::{Error, Result};
use crate::sim::engine::{Command, EngineKind};
use crate::sim::{Model, State};
use columns::{Figure, LeggedObserved, Observe, base, contact, figures, observation};
use episode::{Difficulty, LeggedEpisode, StepFeedback};
use reward::{Contacts, LeggedStep};
use std::f64::consts::TAU;
use std::sync::Arc;

/// The robot has fallen if the component of gravity's direction along the base's z axis is above this: −cos 60°. Our
/// choice, between the steepest slope of sand (35°) and a robot that lies on its side (90°).
const FALLEN: f64 = -0.5;
/// The same limit as an angle [rad].
pub const MOST_TILT: f64 = std::f64::consts::FRAC_PI_3;

/// A robot with fewer than four legs has fallen if its hips are lower than this part of their standing height: our choice,
/// because a robot with such low hips kneels or sits. A robot with four or more may lie on its belly in sand and stand
/// up again.
const LOW: f64 = 0.5;

const ABOUT: &str = "\
The robot starts in its default pose just above the ground, with random errors of the joint angles of up to `angle_noise`. A servo at each joint
follows its target, the default position plus the action times `action_scale`. Default positions and gains are those of `default_joint_angles`,
`stiffness` and `damping`, or else of the robot's file, or else found (docs/robots_rules.md has the formulas). Commands are drawn from `commands` at
the start and every `resampling_time`; speeds below 0.05 √(gℓ) are set to zero. `domain_rand` has what else an episode draws, and the pushes.

With `curriculum` an environment has a level from 0 to 1, which is in `info` (docs/robots.md has the formula). A command's error is |mean velocity −
command| / |command|, each component divided by the end of its default range, without the first two seconds. Evaluate policies with `curriculum=None`.

The names of the reward terms and the order of the observation are those of legged_gym (Rudin et al. 2022) and of Isaac Lab's velocity tasks;
velocities, times and torques in rewards are in units of the robot: √(gℓ), √(ℓ/g), Wℓ, with its legs' length ℓ and weight W. A term is multiplied by its
weight and by the control step's duration. A foot is in contact when the ground's force on it is above 2 % of the weight; another body collides when
it is in the ground. Velocities are those of the base link's origin, in the base's frame. In contrast to legged_gym observations are not scaled, a
negative sum of rewards is not clipped at zero, and actions are within ±1, so `action_scale` is larger than 0.25.

An episode terminates when the base has tilted by more than 60° (`bad_orientation`); on `rigid` ground when a body that is part of no leg touches it
(`base_contact`); with fewer than four feet when the middle of the hips is lower than half of its standing height (`base_low`). It is truncated after
`max_episode_steps`, or when its state can no longer be computed (`diverged`).

On ground with heights (`relief`, or ground `dunes`) an episode begins at a random position. `measure_heights` adds the base's height above 17 × 11
points, minus 0.5 m, clipped to ± 1 m. Forces of sand are extrapolated from about 0.5 m/s on.";

pub struct LeggedVelocity {
    spec: Spec,
    rewards: Rewards,
    observation: Features<Observe>,
    figures: Features<Figure>,
    /// Index in an info row of the feet's contacts; the next fields are the indices of the velocities and of the ways to fall.
    contacts: usize,
    velocity: [usize; 3],
    falls: [usize; 3],
    /// Default position of each joint [rad].
    angles: Vec<f64>,
    /// For each foot: does it step half a stride after the first one?
    second: Vec<bool>,
    /// The joint of each action, and the offset of its target at action 1 [rad].
    driven: Vec<(usize, f64)>,
    units: Units,
    /// Factor on the sand's stress at level 0 of the curriculum.
    ease: f64,
    /// Strides in a second of the observed clock [Hz]; 0: it stands.
    clock: f64,
}

/// How an action moves a joint: the joint's target is `default` plus the action times `scale`, and a servo follows the
/// target.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct JointTarget {
    pub joint: String,
    /// [rad], for sliding joints [m]
    pub default: f64,
    pub scale: f64,
    /// Gains [N·m/rad, N·m·s/rad] and torque limit [N·m], if it is known.
    pub stiffness: f64,
    pub damping: f64,
    pub torque_limit: Option<f64>,
    /// Line of the motor [N·m, rad/s] (`sim::actuator`), if it is known.
    pub stall_torque: Option<f64>,
    pub no_load_speed: Option<f64>,
    /// Lowest and highest position, if the joint has stops.
    pub range: Option<[f64; 2]>,
    /// Time in which the servo's reference follows its target, as a first-order lag [s]; None: at once.
    pub target_time: Option<f64>,
}

/// The target of each action of LeggedVelocity in `model`, and those of the joints that are held, whose scale is 0.
/// `action_scale`: the option; `legs`: do actions move the joints of legs alone?
pub fn joint_targets(model: &Model, action_scale: Option<f64>, legs: bool) -> [Vec<JointTarget>; 2] {
    let Some(tree) = &model.tree else { return [Vec::new(), Vec::new()] };
    let names = model.joint_names();
    let driven = driven(tree, action_scale, legs);
    let joints: Vec<_> = tree.tree.joints().collect();
    let target = |(i, scale): (usize, f64)| JointTarget {
        joint: names[i].clone(),
        default: tree.stance.angles[i],
        scale,
        stiffness: tree.motors[i].kp,
        damping: tree.motors[i].kd,
        torque_limit: tree.motors[i].actuator.torque_limit,
        stall_torque: tree.motors[i].actuator.stall_torque,
        no_load_speed: tree.motors[i].actuator.no_load_speed,
        range: joints[i].range,
        target_time: joints[i].target_time,
    };
    let held = driven.held.into_iter().map(|i| (i, 0.0));
    [driven.by_actions.into_iter().map(target).collect(), held.map(target).collect()]
}

impl LeggedVelocity {
    fn difficulty(&self, options: &LeggedOptions, level: f64) -> Difficulty {
        let Some(curriculum) = &options.curriculum else { return Difficulty::FULL };
        let commands = curriculum.commands + (1.0 - curriculum.commands) * level;
        Difficulty { level, ease: self.ease.powf(1.0 - level), commands, pushes: level }
    }

    /// First states of robot and task in an episode at this level of the curriculum.
    fn begin_at(&self, setup: &Setup<LeggedOptions>, level: f64, random: &mut Random) -> (State, TaskState) {
        let noise = setup.options.angle_noise;
        let angles: Vec<f64> = self.angles.iter().map(|a| a + random.uniform(-noise, noise)).collect();
        let difficulty = self.difficulty(setup.options, level);
        let legged = LeggedEpisode::draw(setup.options.draws(&self.units), difficulty, setup.model, random);
        // The drawn values lie in checked ranges, so this cannot fail; if it did, the session's own model would be
        // used.
        let model = legged.model(setup.model).map_or_else(|_| setup.model.clone(), Arc::new);
        // A random start position on ground that is not flat.
        let size = model.scene.relief.as_ref().map(|r| r.size());
        let at = size.map_or([0.0; 2], |size| size.map(|length| random.uniform(0.0, length)));
        let mut state = State::at_rest(height(&model, &angles, at), &angles);
        (state.position[0], state.position[1]) = (at[0], at[1]);
        state.references.copy_from_slice(&self.angles);
        let [speed, _, turn] = legged.now;
        (state, TaskState { speed, turn, model: Some(model), legged: Some(legged), ..TaskState::default() })
    }
}

impl Task for LeggedVelocity {
    const ID: &'static str = "sandgait/LeggedVelocity-v1";
    const SIDEWAYS: bool = true;
    type Options = LeggedOptions;

    fn engine(_options: &LeggedOptions) -> EngineKind {
        EngineKind::Tree
    }

    fn drawn_bytes(setup: &Setup<LeggedOptions>) -> usize {
        setup.model.episode_bytes()
    }

    fn list_bytes(setup: &Setup<LeggedOptions>) -> usize {
        setup.options.draws(&Units::of(setup.model)).list_bytes()
    }

    fn model(options: &LeggedOptions) -> Result<Model> {
        options.model()
    }

    fn new(setup: &Setup<LeggedOptions>) -> Result<Self> {
        let options = setup.options;
        let Some(tree) = &setup.model.tree else {
            return Err(Error::invalid("robot", "is no tree of bodies"));
        };
        if tree.stance.legs.is_empty() {
            let reason = "has no legs: no branch of joints ends in a shape below the base and moves it up and down";
            return Err(Error::invalid("robot", format!("{:?} {reason}", tree.tree.name)));
        }
        let (joints, rewards) = (&setup.model.joint_names(), options.rewards);
        let feet: Vec<String> = tree.stance.feet.iter().map(|i| tree.tree.bodies[*i].name.clone()).collect();
        let driven = driven(tree, options.action_scale, legs_alone(&options.joints)?).by_actions;
        let motors: Vec<String> = driven.iter().map(|(i, _)| joints[*i].clone()).collect();
        let (observation, figures) =
            (observation(joints, &motors, options.gait_clock.is_some(), options.measure_heights), figures(&feet));
        let reward = rewards.terms();
        let spec = Spec {
            id: Self::ID,
            summary: "A legged robot follows commanded velocities on sand or hard ground; actions are differences of joint targets from the default pose."
                .into(),
            observation: observation.columns(),
            action: Column::each(&motors, "offset of the target over action_scale", "1", 1.0),
            about: ABOUT,
            info: [Column::rewards(&reward), figures.columns()].concat(),
            reward,
            max_episode_steps: options.max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        let angles = tree.stance.angles.clone();
        let first = feet.first().map(|foot| contact(foot).name);
        let at = |name: &str| spec.info.iter().position(|column| column.name == name).unwrap_or(0);
        let contacts = first.as_ref().map_or(0, |name| at(name));
        let velocity = ["speed", "lin_vel_y", "ang_vel_yaw"].map(at);
        let falls = ["bad_orientation", "base_contact", "base_low"].map(at);
        let units = Units::of(setup.model).up_to(options.max_velocity);
        let ease = options.curriculum.map_or(1.0, |_| curriculum::ease(setup.model));
        let clock = options.gait_clock.unwrap_or(0.0);
        let second = tree.stance.second(&tree.tree);
        Ok(Self {
            spec,
            rewards,
            observation,
            figures,
            contacts,
            velocity,
            falls,
            angles,
            second,
            driven,
            units,
            ease,
            clock,
        })
    }

    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup<LeggedOptions>, random: &mut Random) -> (State, TaskState) {
        let level = setup.options.curriculum.map_or(1.0, |c| c.level);
        self.begin_at(setup, level, random)
    }

    fn begin_after(&self, setup: &Setup<LeggedOptions>, last: &TaskState, random: &mut Random) -> (State, TaskState) {
        let level = match (&setup.options.curriculum, &last.legged) {
            (None, _) => 1.0,
            (Some(curriculum), Some(last)) => curriculum.next(last.level, &last.followed),
            (Some(curriculum), None) => curriculum.level,
        };
        self.begin_at(setup, level, random)
    }

    fn command(&self, action: &[f32], _state: &State, command: &mut Command) {
        command.targets.clear();
        command.targets.extend_from_slice(&self.angles);
        for ((joint, scale), part) in self.driven.iter().zip(action) {
            command.targets[*joint] += scale * f64::from(*part);
        }
    }

    fn after_step(
        &self,
        setup: &Setup<LeggedOptions>,
        task_state: &mut TaskState,
        _state: &State,
        info: &[f32],
    ) -> Change {
        let Some(legged) = &mut task_state.legged else { return Change::Nothing };
        let seen = StepFeedback {
            feet: &info[self.contacts..][..legged.air.len()],
            velocity: self.velocity.map(|k| info[k].into()),
            fell: self.falls.iter().any(|k| info[*k] > 0.0),
            clock: self.clock,
        };
        let push = legged.after_step(setup.options.draws(&self.units), self.units.commanded(), &seen);
        [task_state.speed, _, task_state.turn] = legged.now;
        push.map_or(Change::Nothing, Change::Push)
    }

    fn command_ranges(&self, setup: &Setup<LeggedOptions>) -> Option<[[f64; 2]; 3]> {
        Some(self.units.ranges(&setup.options.commands))
    }

    fn set_command(&self, task_state: &mut TaskState, command: [f64; 3]) {
        [task_state.speed, _, task_state.turn] = command;
        if let Some(legged) = &mut task_state.legged {
            (legged.commands, legged.now) = (vec![command], command);
        }
    }

    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]) {
        let [gravity, velocity, angular_velocity] = base(task_state.model.as_deref(), state);
        let command = task_state.legged.as_ref().map_or([0.0; 3], |l| l.now);
        let ahead = state.rotation();
        let heading = ahead[1][0].atan2(ahead[0][0]).sin_cos();
        let phase = task_state.legged.as_ref().map_or(0.0, |l| l.phase(self.clock));
        let (sine, cosine) = (TAU * phase).sin_cos();
        let default = &self.angles;
        let observed = LeggedObserved {
            task_state,
            state,
            last_action,
            default,
            command,
            gravity,
            velocity,
            angular_velocity,
            heading,
            clock: [sine, cosine],
        };
        self.observation.fill(row, |value, i| value(&observed, i));
    }

    fn evaluate(&self, setup: &Setup<LeggedOptions>, t: &Transition, info: &mut [f32]) -> bool {
        let Some(legged) = &t.task_state.legged else { return false };
        let contacts = Contacts::of(t.model, t.after, t.foot_loads);
        let [gravity, velocity, angular_velocity] = base(Some(t.model), t.after);
        let fallen = gravity[2] > FALLEN;
        let base_contact = (contacts.base || contacts.upper) && !t.model.has_sand();
        let too_low = is_too_low(t.model, t.after);
        let default = &self.angles;
        let tracked = legged.tracked([velocity[0], velocity[1], angular_velocity[2]], self.clock);
        let step = LeggedStep {
            t,
            phase: (self.clock > 0.0).then(|| legged.phase(self.clock)),
            second: &self.second,
            tracked,
            shaping: setup.options.tracking_shaping.then(|| LeggedEpisode::share(self.clock)),
            legged,
            contacts,
            default,
            units: &self.units,
            sigma: setup.options.tracking_sigma,
            gravity,
            velocity,
            angular_velocity,
            fallen,
            base_contact,
            too_low,
        };
        let (rewards, rest) = info.split_at_mut(self.spec.reward.len());
        self.rewards.fill(&step, t.period, rewards);
        self.figures.fill(rest, |value, i| value(&step, i));
        step.terminated()
    }

    /// All environments of a session need robots with the same feet, and either all or none need ground with heights.
    fn check_change(old: &Model, new: &Model) -> Result<()> {
        if old.scene.relief.is_some() != new.scene.relief.is_some() {
            let reason = "a reset changes neither flat ground to ground with heights nor back: make other environments";
            return Err(Error::invalid("ground", reason));
        }
        let feet = |model: &Model| model.tree.as_ref().map(|tree| tree.stance.feet.clone());
        if feet(old) != feet(new) {
            return Err(Error::invalid(
                "default_joint_angles",
                "in this pose the robot stands on other feet: make other environments",
            ));
        }
        Ok(())
    }

    /// Builds the model again from the drawn values.
    fn resume(setup: &Setup<LeggedOptions>, task_state: &mut TaskState) -> std::result::Result<(), String> {
        let TaskState { model: None, ground: None, legged: Some(legged), .. } = task_state else {
            return Err("its robot".into());
        };
        let units = Units::of(setup.model).up_to(setup.options.max_velocity);
        if !legged.is_sound(setup.options.draws(&units), setup.model) {
            return Err("its drawn values".into());
        }
        task_state.model = Some(Arc::new(legged.model(setup.model).map_err(|e| e.to_string())?));
        Ok(())
    }
}

/// Is the base of a robot with fewer than four legs lower than [`LOW`] of its standing height?
fn is_too_low(model: &Model, state: &State) -> bool {
    let Some(tree) = &model.tree else { return false };
    tree.stance.legs.len() < 4 && tree.is_low(state, LOW, |x, y| model.surface_height(x, y))
}

/// Height of the base's origin above `at` at which the lowest point touches the ground [m].
fn height(model: &Model, angles: &[f64], at: [f64; 2]) -> f64 {
    let Some(tree) = &model.tree else { return 0.0 };
    tree.height_over(angles, |x, y| model.surface_height(at[0] + x, at[1] + y))
}
