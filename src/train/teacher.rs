//! The start of a training for a robot with six or more legs: the policy first imitates a plain gait of the robot
//! ([`GaitPrior`]). The gait acts, with the policy's exploration noise, so that the policy also learns the way back to
//! it; the critic learns its returns. Afterwards nothing holds the policy to it.

use super::settings::Hyperparameters;
use crate::env::legged::columns::CLOCK;
use crate::env::legged::prior::{GaitPrior, LEAST};
use crate::env::legged::units::Units;
use crate::env::legged::{LEGS, LeggedVelocity};
use crate::env::registry::Blueprint;
use crate::env::spec::RewardTerm;
use crate::env::{Shard, Task};
use crate::error::Result;
use crate::sim::tree::{JointKind, TreeJoint, TreeModel};
use serde_json::{Value, json};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Names of the observation's columns with the command.
const COMMANDS: [&str; 3] = ["commanded lin_vel_x", "commanded lin_vel_y", "commanded ang_vel_yaw"];
/// Options with the frequency of the observed clock, the scale of actions, the greatest speeds of commands and the width of the
/// tracking terms, and the reward term for long steps.
const CLOCK_RATE: &str = "gait_clock";
const JOINTS: &str = "joints";
const ACTION_SCALE: &str = "action_scale";
const SPEEDS: &str = "max_velocity";
const SIGMA: &str = "tracking_sigma";
/// The option by which tracking terms of the mean velocity of a stride count at once what a step changes in it.
const SHAPING: &str = "tracking_shaping";
const AIR_TIME: &str = "feet_air_time";
/// The share of commands along one axis, among the options of commands.
const ONE_AXIS: &str = "single_axis";
/// The scale of actions with which legs that sink in step higher [rad]: our choice, twice the default's largest.
const LARGE: f64 = 1.0;
/// σ of the tracking terms of a robot with a clock: our choice. They take the mean velocity of a stride, which does not sway, so
/// they may be narrow; and at slow commands, a small drift is a large part of the command. docs/learning_hexapods.md compares
/// it with the default.
const NARROW: f64 = 0.03;
/// Share of commands along one axis alone: our choice. Of commands that are drawn along all three axes hardly any is along one,
/// and robots then turn or walk too fast where only that is commanded (docs/learning_hexapods.md).
const SINGLE_AXIS: f64 = 0.5;
/// Strides of two legs in a second, in units of √(g/ℓ): our choice; the 0.8 s of G1 and H1 in unitree_rl_gym (`period` in `g1_env.py`) are
/// 0.33 and 0.38 of it.
const BIPED_STRIDES: f64 = 0.33;
/// The reward term for feet that bear load in time with the clock, and its weight for two legs: unitree_rl_gym's for G1 and H1. A small
/// biped with large soles that stands well did not begin to walk without it (docs/robots_results.md).
const CONTACT: &str = "contact";
const CONTACT_WEIGHT: f64 = 0.18;
/// The reward term for long steps in a turn on the spot, whose weight for two long legs is that of [`AIR_TIME`]. With it the
/// curriculum of G1 rises sooner; `feet_air_time` of mjlab counts in turns, too. Short legs do not need it.
const TURNING: &str = "turning_air_time";
/// Legs with fewer strides in a second are long: our choice.
const LONG_LEGS: f64 = 1.75;
/// What the plain gait may lose by one term of the reward, as a share of what it earns by following exactly: our choice. A
/// term that costs more makes standing, or a worse gait, the best one. Its weight is made for robots whose motors mostly carry their
/// weight.
const DEAR: f64 = 0.1;
/// The term for bodies that touch the ground. Where it is too dear the legs wade, and contact of thighs is no fault, so it is left
/// out: with a weaker one olli gave up its gait to keep its thighs out of the sand (docs/learning_hexapods.md).
const COLLISION: &str = "collision";
/// Duration of the walk that shows what the gait loses [s]: our choice, four strides or more.
const WALK: f64 = 3.0;
/// Terms of the reward for following commands, and the one of a fall, which costs nothing while the robot walks.
const TRACKING: [&str; 2] = ["tracking_lin_vel", "tracking_ang_vel"];
const FALL: &str = "termination";

/// The plain gait of the robot of LeggedVelocity in `blueprint`; None: it has fewer than six legs, or an odd number.
pub fn plain_gait(blueprint: &Blueprint) -> Result<Option<GaitPrior>> {
    gait_with(blueprint, blueprint.task.option(ACTION_SCALE).as_f64())
}

fn gait_with(blueprint: &Blueprint, action_scale: Option<f64>) -> Result<Option<GaitPrior>> {
    let task = &blueprint.task;
    GaitPrior::of(task.model(), action_scale, task.option(JOINTS) == LEGS, task.option(CLOCK_RATE).as_f64())
}

/// The plain gait with the larger scale of actions, if the scale is not given, all joints of the legs turn, and the gait is clearly
/// better than `usual`.
fn with_larger_steps(blueprint: &Blueprint, options: &Value, usual: &GaitPrior) -> Result<Option<GaitPrior>> {
    let turn = |tree: &TreeModel| tree.tree.joints().all(|joint| joint.kind != JointKind::Slide);
    if !options[ACTION_SCALE].is_null() || !blueprint.task.model().tree.as_ref().is_some_and(|tree| turn(tree)) {
        return Ok(None);
    }
    Ok(gait_with(blueprint, Some(LARGE))?.filter(|larger| larger.is_better_than(usual)))
}

/// For a robot with arms, holds their joints. For a robot with two legs, sets in `options` of LeggedVelocity the clock of the observation,
/// the weights of the terms for steps in time and in turns, the share of commands along one axis (where every command has a part forward,
/// a biped does not learn to step in place for a turn), shaped tracking terms, and for slow servos the greatest speeds of commands. For a
/// robot with a plain gait, sets the larger scale of actions if the gait is clearly better with it, the clock to the gait's strides, the
/// greatest speeds to what the gait reaches, narrow and shaped tracking terms, the share of commands along one axis, and the weight of the term for long steps to 0: its
/// threshold is made for the strides of four legs, and on six it makes standing the best gait. Options that are given stay; values in `kept`, the options of a training that goes on, come before the gait's.
/// Terms by which the gait would lose more than [`DEAR`] become weaker.
pub fn suit(options: &mut Value, kept: &Value) -> Result<Suited> {
    let blueprint = Blueprint::new(LeggedVelocity::ID, options.clone())?;
    let held = hold_arms(&blueprint, options, kept);
    let blueprint = if held > 0 { Blueprint::new(LeggedVelocity::ID, options.clone())? } else { blueprint };
    let prior = plain_gait(&blueprint)?;
    let on_two = blueprint.task.model().tree.as_ref().is_some_and(|tree| tree.stance.legs.len() == 2);
    let old = |name: &str| Some(kept[name].clone()).filter(|value| !value.is_null());
    let Some(prior) = prior else {
        let two_legs = if on_two { suit_two_legs(options, kept, &blueprint) } else { Vec::new() };
        return Ok(Suited { held, on_two, two_legs, ..Suited::default() });
    };
    let larger = if kept.is_null() { with_larger_steps(&blueprint, options, &prior)? } else { None };
    suggest(options, kept, &[ACTION_SCALE], json!(larger.as_ref().map(|_| LARGE)));
    let (prior, larger) = (larger.clone().unwrap_or(prior), larger.is_some());
    if options[CLOCK_RATE].is_null() {
        options[CLOCK_RATE] = old(CLOCK_RATE).unwrap_or_else(|| json!(prior.stride.frequency));
    }
    suggest(options, kept, &["commands", ONE_AXIS], json!(SINGLE_AXIS));
    suggest(options, kept, &[SHAPING], json!(true));
    if options[SIGMA].is_null() {
        options[SIGMA] = old(SIGMA).unwrap_or_else(|| json!(NARROW));
    }
    let speeds = options[SPEEDS].is_null() && !ranges_are_given(options);
    if speeds {
        options[SPEEDS] = old(SPEEDS).unwrap_or_else(|| json!(prior.speeds()));
    }
    let mut rewards = options["rewards"].as_object().cloned().unwrap_or_default();
    rewards.retain(|_, weight| !weight.is_null());
    let mut kept_weights = Vec::new();
    let weaker = match kept["rewards"].as_object() {
        Some(old) => {
            for (name, weight) in old {
                if !rewards.contains_key(name) {
                    rewards.insert(name.clone(), weight.clone());
                    kept_weights.push(format!("{name} {weight}"));
                }
            }
            Vec::new()
        }
        None => {
            rewards.entry(AIR_TIME).or_insert(json!(0.0));
            let own = |(name, _): &(&'static str, f64)| !rewards.contains_key(*name);
            let weaker: Vec<_> = affordable(options, prior)?.into_iter().filter(own).collect();
            weaker.iter().for_each(|(name, weight)| drop(rewards.insert((*name).into(), json!(weight))));
            weaker
        }
    };
    options["rewards"] = Value::Object(rewards);
    Ok(Suited { speeds, larger, weaker, kept: kept_weights, held, ..Suited::default() })
}

/// Sets options for a robot with two legs, see [`suit`]. Returns those whose values are its own.
fn suit_two_legs(options: &mut Value, kept: &Value, blueprint: &Blueprint) -> Vec<String> {
    let strides = two_digits(BIPED_STRIDES * Units::of(blueprint.task.model()).rate);
    let mut own: Vec<(&[&str], Value)> = vec![
        (&["commands", ONE_AXIS], json!(SINGLE_AXIS)),
        (&[CLOCK_RATE], json!(strides)),
        (&["rewards", CONTACT], json!(CONTACT_WEIGHT)),
        (&[SHAPING], json!(true)),
    ];
    if strides < LONG_LEGS {
        let air_time = blueprint.task.spec().reward.iter().find(|term| term.name == AIR_TIME);
        own.extend(air_time.map(|term| (&["rewards", TURNING][..], json!(term.weight))));
    }
    own.retain(|(path, value)| suggest(options, kept, path, value.clone()));
    let mut set: Vec<String> = own.iter().map(|(path, value)| format!("{} {value}", path.join("."))).collect();
    let slow = speeds_of_servos(blueprint).filter(|_| !ranges_are_given(options));
    if let Some(speeds) = slow.filter(|speeds| suggest(options, kept, &[SPEEDS], json!(speeds))) {
        set.push(format!("{SPEEDS} {speeds:?} by what the servos reach"));
    }
    set
}

fn ranges_are_given(options: &Value) -> bool {
    let given = |name: &str| options["commands"].get(name).is_some_and(|range| !range.is_null());
    ["lin_vel_x", "lin_vel_y", "ang_vel_yaw"].into_iter().any(given)
}

/// The greatest speeds of commands forward, to the left [m/s] and yaw [rad/s] for legs whose servos are slow; None: they are fast
/// enough for the default ranges. In a walk with a foot on the ground for 0.6 of the stride the hip swings the leg ahead 1.5 times as
/// fast as v/ℓ, and π/2 times that at the middle of a sinusoid; a motor with a falling line gives most power at half of the speed at
/// which its torque is 0. As for a plain gait they are at least [`LEAST`] of the default ranges.
fn speeds_of_servos(blueprint: &Blueprint) -> Option<[f64; 3]> {
    let model = blueprint.task.model();
    let tree = model.tree.as_ref()?;
    let free = |joint: &TreeJoint| {
        let damped = joint.torque_limit.filter(|_| joint.damping > 0.0);
        let damped = damped.map(|limit| (limit - joint.friction).max(0.0) / joint.damping);
        [damped, joint.motor.no_load_speed].into_iter().flatten().fold(f64::INFINITY, f64::min)
    };
    let legs = |body: &usize| tree.tree.bodies[*body].joint.as_ref().map(free);
    let slowest = tree.stance.legs.iter().flatten().filter_map(legs).fold(f64::INFINITY, f64::min);
    let most = 0.5 * slowest * tree.stance.leg_length / (1.5 * FRAC_PI_2);
    let usual = Units::of(model).commanded();
    let share = most / usual[0];
    (share < 1.0).then(|| usual.map(|speed| two_digits(share.max(LEAST) * speed)))
}

/// Sets an option, or one in a table, that is not given. A training that goes on keeps what it has. Is `own` the value now?
fn suggest(options: &mut Value, kept: &Value, path: &[&str], own: Value) -> bool {
    let at = format!("/{}", path.join("/"));
    let given = options.pointer(&at).is_some_and(|value| !value.is_null());
    let value = if kept.is_null() { own } else { kept.pointer(&at).cloned().unwrap_or_default() };
    if given || value.is_null() {
        return false;
    }
    match path {
        [table, name] => options[*table][*name] = value,
        names => names.iter().for_each(|name| options[*name] = value.clone()),
    }
    kept.is_null()
}

/// Holds the joints of waist, arms and head, if the option is not given: their noise throws a biped over before it has learnt to stand.
/// Returns their number. A training that goes on keeps what it has.
fn hold_arms(blueprint: &Blueprint, options: &mut Value, kept: &Value) -> usize {
    let count = blueprint.task.model().tree.as_ref().map_or(0, |tree| tree.upper_joints().len());
    if count > 0 && (suggest(options, kept, &[JOINTS], json!(LEGS)) || kept[JOINTS] == LEGS) && options[JOINTS] == LEGS
    {
        return count;
    }
    0
}

/// What [`suit`] has changed.
#[derive(Default)]
pub struct Suited {
    /// The ranges of commands.
    speeds: bool,
    /// Is the scale of actions the larger one?
    larger: bool,
    /// Terms of the reward that became weaker, with their weights.
    weaker: Vec<(&'static str, f64)>,
    /// Terms whose weights are those of the training that goes on, with these.
    kept: Vec<String>,
    /// Number of joints that are in no leg and hold their default position.
    held: usize,
    /// Has the robot two legs?
    pub on_two: bool,
    /// Options that were set because the robot has two legs.
    two_legs: Vec<String>,
}

impl Suited {
    /// Lines that say which joints are held, and which options suit two legs.
    pub fn notes(&self) -> Vec<String> {
        let held = (self.held > 0).then(|| {
            format!(
                "{} joints that are in no leg hold their default position (--option joints=all moves them)",
                self.held
            )
        });
        let own = self.two_legs.join(", ");
        let two_legs = (!own.is_empty())
            .then(|| format!("because the robot has two legs: {own} (--set gait_prior=0: none of them)"));
        held.into_iter().chain(two_legs).collect()
    }
}

/// Terms of the reward by which the plain gait loses more than [`DEAR`] when it walks forward, and the weights with which it
/// loses as much, or 0 for [`COLLISION`].
fn affordable(options: &Value, prior: GaitPrior) -> Result<Vec<(&'static str, f64)>> {
    let mut own = options.clone();
    ["domain_rand", "curriculum"].into_iter().for_each(|name| own[name] = Value::Null);
    let blueprint = Blueprint::new(LeggedVelocity::ID, own)?;
    let (spec, forward) = (blueprint.task.spec(), prior.speeds()[0]);
    let Some(teacher) = Teacher::in_task(&blueprint, prior) else { return Ok(Vec::new()) };
    let mut shard = Shard::new(&blueprint, 1)?;
    shard.reset(|_| true, Some(&[0]), |_| None);
    let (mut action, mut lost) = (vec![0.0; shard.actions()], vec![0.0; spec.reward.len()]);
    let steps = (WALK * spec.control_rate) as usize;
    for _ in 0..steps {
        shard.set_command(0, [forward, 0.0, 0.0]);
        teacher.act(&shard.rows.observations, &mut action);
        shard.step(&action);
        lost.iter_mut().zip(&shard.rows.infos).for_each(|(sum, term)| *sum -= f64::from(*term));
    }
    let earned: f64 = spec.reward.iter().filter(|term| TRACKING.contains(&term.name)).map(|term| term.weight).sum();
    let most = DEAR * earned * steps as f64 / spec.control_rate;
    let dear = spec.reward.iter().zip(lost).filter(|(term, lost)| term.name != FALL && *lost > most);
    let affordable = |term: &RewardTerm, lost: f64| match term.name {
        COLLISION => 0.0,
        _ => two_digits(term.weight * most / lost),
    };
    let weaker = dear.map(|(term, lost)| (term.name, affordable(term, lost), term.weight));
    Ok(weaker.filter(|(_, now, before)| now != before).map(|(name, now, _)| (name, now)).collect())
}

/// `x` with two digits, so that it reads well.
fn two_digits(x: f64) -> f64 {
    format!("{x:.1e}").parse().unwrap_or(x)
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
        Ok(plain_gait(blueprint)?.and_then(|prior| Self::in_task(blueprint, prior)))
    }

    /// None: the task's observation has no clock.
    fn in_task(blueprint: &Blueprint, prior: GaitPrior) -> Option<Self> {
        let at = |name: &str| blueprint.task.spec().observation.iter().position(|c| c.name == name);
        let ([Some(sine), Some(cosine)], Some(x)) = (CLOCK.map(at), at(COMMANDS[0])) else { return None };
        let columns = COMMANDS.map(|name| at(name).unwrap_or(x));
        Some(Self { prior, columns, clock: [sine, cosine] })
    }

    /// Fills `action` with the gait's action for a robot that has this observation.
    pub fn act(&self, observation: &[f32], action: &mut [f32]) {
        let number = |k: usize| f64::from(observation[k]);
        let [sine, cosine] = self.clock.map(number);
        self.prior.action(self.columns.map(number), sine.atan2(cosine) / TAU, action);
    }

    /// What the training says of it.
    pub fn note(&self, steps: u64, suited: &Suited) -> String {
        let [x, y, yaw] = self.prior.speeds();
        let reached = match self.prior.slow {
            Some(speed) => format!(
                "though it walks at {speed:.2} m/s only on this ground: check torques, speeds and damping of the joints, and the feet"
            ),
            None => "which it reaches on this ground".to_owned(),
        };
        let commands = if suited.speeds {
            format!(
                "commands are at most {x:.2} m/s forward, {y:.2} m/s to the side and {yaw:.2} rad/s, {reached} \
                 (--option max_velocity=[x,y,yaw] sets others)"
            )
        } else {
            "commands are those of the options".to_owned()
        };
        let larger = if suited.larger {
            format!("action_scale is {LARGE} rad, with which it walks better; ")
        } else {
            String::new()
        };
        let weaker: Vec<String> = suited.weaker.iter().map(|(name, weight)| format!("{name} {weight}")).collect();
        let weaker = match &weaker[..] {
            [] if !suited.kept.is_empty() => {
                format!("; reward weights are those with which the training began: {}", suited.kept.join(", "))
            }
            [] => String::new(),
            all => format!(
                "; reward terms are weaker by which the plain gait would lose more than {} % of what following earns: {}",
                100.0 * DEAR,
                all.join(", ")
            ),
        };
        format!(
            "the policy imitates a plain {} of {:.1} strides a second for {:.2} M steps and observes a clock of them (--set gait_prior=0: neither); \
             {larger}unless they are given, reward term feet_air_time is 0, tracking_sigma {NARROW}, tracking_shaping true and commands.single_axis {SINGLE_AXIS}; \
             {commands}{weaker}",
            self.prior.stride.name(),
            self.prior.stride.frequency,
            steps as f64 / 1e6
        )
    }
}
