//! `sandgait/LegStroke-v0`: the stroke of one leg through sand that gives the most thrust per work.

use super::feature::{Features, flag};
use super::random::Random;
use super::sensors::{Part, Sensor};
use super::spec::{CONTROL_RATE, Column, RewardTerm, Spec};
use super::task::{Setup, Task, TaskState, Transition};
use super::walking::{MAX_STEPS, set_sand};
use crate::error::{Error, Result, check_range};
use crate::options;
use crate::options::NumberPair;
use crate::sand::{Law, Medium};
use crate::sim::engine::{Command, EngineKind};
use crate::sim::model::Scene;
use crate::sim::{Model, Robot, State};
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

options! {
    /// Options of LegStroke. `dt`: with this time step, efficiencies differ by at most 1 % from those with an eighth of
    /// the time step, which a test checks.
    pub struct StrokeTaskOptions {
        law: Law = Law::Li2013, "resistive force law: li2013, penetration-drag-1d or agarwal2023";
        dt: f64 = 4e-3, "time step [s], which divides the control period";
        angle_noise: f64 = 0.0, [0.0, PI], "largest difference of the initial joint angles from stroke.start, uniformly distributed [rad]";
        medium: String = Medium::DEFAULT.into(), reset, "sand: a medium's name, zeta=VALUE or mu=VALUE,rho=VALUE";
        sand: String = String::new(), "text of a sand.toml, for example from a diagnosis (in Python its path); it replaces medium and law";
        max_episode_steps: u32 = 50, [1.0, MAX_STEPS], "number of control steps of a stroke, at 50 Hz";
        stroke: StrokeOptions = StrokeOptions::default(), reset, "carriage, leg and constraint";
    }
}

options! {
    /// Carriage, leg and constraint. Our choices: at `carriage_speed` the carriage moves by two lengths of the leg
    /// during a stroke, so that the best constant-rate strokes are near the middle of the range of joint speeds; `lift`
    /// is a sixth of the weight of the reference hexapod scaled to this leg (lengths × 1.9, mass × 1.9³); `lift_weight`
    /// is more than the greatest possible efficiency, and `exit_weight` equals it. `height` and `start` are as in Li et
    /// al. 2012, section 3: the tip points forward, 1.75 rad from straight down. Below the least allowed carriage
    /// speed, thrust per work has no meaning (see the task's page); above the greatest, RFT is not valid.
    #[derive(Copy, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct StrokeOptions {
        carriage_speed: f64 = 0.2, [0.01, 0.5], reset, "speed of the carriage toward +x [m/s]";
        height: f64 = 0.02, [0.0, 0.1], reset, "height of the hip over the sand [m]";
        start: NumberPair = NumberPair([-1.75, 0.0]), reset, "angles [hip, knee] at the start [rad]; the leg must be outside of the sand";
        lift: f64 = 1.7, [1e-3, 1e3], reset, "least mean lift over the stroke [N]";
        lift_weight: f64 = 2.0, [0.0, 1e3], reset, "penalty of a stroke without lift";
        exit_weight: f64 = 1.0, [0.0, 1e3], reset, "penalty of a stroke that leaves the leg 1 cm or more in the sand";
    }
}

impl StrokeOptions {
    /// Checks the start; `model`: the leg. A nanometre in the sand is rounding.
    fn validate(&self, model: &Model) -> Result<()> {
        let range = |i: usize| model.legs[0][i].range.unwrap_or([-TAU, TAU]);
        for (i, angle) in self.start.0.iter().enumerate() {
            check_range(&format!("stroke.start[{i}]"), *angle, range(i)[0]..=range(i)[1])?;
        }
        let deepest = self.deepest(model, &self.start.0);
        if deepest > 1e-9 {
            let reason = format!("{:?} begins {:.1} mm in the sand", self.start.0, 1e3 * deepest);
            return Err(Error::invalid("stroke.start", reason));
        }
        Ok(())
    }

    /// Depth of the leg's deepest joint or tip [m], 0 if it is out of the sand.
    fn deepest(&self, model: &Model, angles: &[f64]) -> f64 {
        (model.standing_height(angles) - self.height).max(0.0)
    }
}

/// Joint speed at action 1 [rad/s]: our choice, one turn in the default stroke. A straight leg's tip then reaches
/// 0.7 m/s, beyond the some 0.5 m/s up to which resistive force theory is known to be valid.
const TOP_SPEED: f64 = TAU;

/// Least work in the efficiency [J], so that the efficiency of a leg at rest is defined: our choice, a hundredth of the
/// work of good strokes.
const LEAST_WORK: f64 = 1e-3;

/// If the leg is this deep in the sand at the end of a stroke, the penalty has its full size [m]. Our choice, about a
/// tenth of the leg's length.
const LEFT_DEPTH: f64 = 0.01;

/// Bounds of the observation: our choice, far above good strokes on the default sand. Larger values are clipped.
const TORQUE: f64 = 10.0; // [N·m]
const IMPULSE: f64 = 20.0; // [N·s]
const WORK: f64 = 20.0; // [J]

const ABOUT: &str = "\
A carriage moves one leg over the sand at a constant speed and height and measures the forces, like the arm of Li et al. 2012. The
actions are the speeds of hip and knee. An episode is one stroke. Forces come from the sand's law on the leg's 24 segments.
The leg has no mass, so only the sand does work on it.

**Goal**: much thrust for little work. Thrust is the sand's mean forward force on the leg. Work is that of both joints
together, ∫Σ τ ω dt, which the sand and the carriage receive. The reward measures the *efficiency* of propulsion,

```text
efficiency = thrust impulse [N·s] × carriage speed [m/s] / work [J],
```

which is the share of the work that pushes the carriage. It is thrust / work times a constant, has no unit, and cannot exceed 1,
because sand only dissipates energy. With a carriage at rest thrust / work would have no maximum: the sand's forces do not
depend on the speed, so the same path at half the speed gives twice the impulse for the same work. With a moving carriage
the path depends on the speed, so there is a maximum.

**Constraint**: the mean lift over the whole stroke is at least `stroke.lift`, and the leg is outside of the sand at the end. Violations
have penalties. The reward's terms are changes from step to step, so that the return is exactly

```text
efficiency − lift_weight · (share of the lift that is missing) − exit_weight · (depth at the end / 1 cm, at most 1)
```

Here the efficiency is clipped to [−1, 1], and its work is at least 1 mJ. The episode terminates at the end of the stroke.

**Baseline**: the best circular stroke. In a circular stroke the knee angle is constant and the hip turns at a constant speed; a search
finds the best knee angle, speed and start (`stroke.start`).";

/// Computes one number of an observation from the task's state, the robot's, the last action and the stroke's length [s].
type Observe = fn(&TaskState, &State, &[f32], f64, usize) -> f64;

/// Computes one figure of a step.
type Figure = fn(&StrokeStep) -> f64;

pub struct LegStroke {
    spec: Spec,
    observation: Features<Observe>,
    figures: Features<Figure>,
    /// Ranges of the joints [rad].
    ranges: Vec<Option<[f64; 2]>>,
    /// Length of a stroke [s].
    duration: f64,
}

/// Results of a stroke so far.
struct Account {
    /// Thrust impulse × carriage speed / work, in [-1, 1].
    efficiency: f64,
    /// Share of the lift impulse that is still missing. It counts as 0 before the stroke begins, so that the steps'
    /// terms add up to the missing share at the end.
    missing: f64,
    /// Finished share of the stroke.
    progress: f64,
}

/// The arguments of reward terms and figures.
struct StrokeStep<'a> {
    t: &'a Transition<'a>,
    before: Account,
    after: Account,
    /// Depth of the leg in the sand at the end of the stroke [m].
    left: f64,
    /// Length of the whole stroke [s].
    duration: f64,
}

impl StrokeStep<'_> {
    /// Mean force along axis `i` in this step [N].
    fn force(&self, i: usize) -> f64 {
        (self.t.after.impulse[i] - self.t.before.impulse[i]) / self.t.period
    }
}

/// The reward's terms: name, description, weight, function of the step.
fn terms(stroke: &StrokeOptions) -> [(&'static str, &'static str, f64, Figure); 3] {
    [
        ("efficiency", "change of the efficiency, thrust impulse × carriage speed / work", 1.0, |s| {
            s.after.efficiency - s.before.efficiency
        }),
        ("lift", "−change of the missing share of the lift impulse", stroke.lift_weight, |s| {
            s.before.missing - s.after.missing
        }),
        ("exit", "in the last step: −depth of the leg / 1 cm, at least −1", stroke.exit_weight, |s| {
            -(s.left / LEFT_DEPTH).min(1.0)
        }),
    ]
}

/// Info columns after the reward's terms.
fn figures() -> Features<Figure> {
    Features::<Figure>::none()
        .free("thrust", "N", |s| s.force(0))
        .free("lift", "N", |s| s.force(2))
        .free("work", "J", |s| s.t.after.work - s.t.before.work)
        .one("efficiency", "1", -1.0, 1.0, |s| s.after.efficiency)
        .free("mean_lift", "N", |s| s.t.after.impulse[2] / s.duration)
        .flag("diverged", |s| flag(s.t.diverged))
}

impl LegStroke {
    /// Results of the stroke up to `state`. The finished share of the stroke follows from the carriage's distance.
    fn account(&self, stroke: &StrokeOptions, state: &State) -> Account {
        let progress = state.position[0] / (stroke.carriage_speed * self.duration);
        let [thrust, _, lift] = state.impulse;
        let efficiency = (thrust * stroke.carriage_speed / state.work.max(LEAST_WORK)).clamp(-1.0, 1.0);
        let begun = progress > 0.0;
        let missing = if begun { (1.0 - lift / (stroke.lift * self.duration)).max(0.0) } else { 0.0 };
        Account { efficiency, missing, progress }
    }
}

impl Task for LegStroke {
    const ID: &'static str = "sandgait/LegStroke-v0";
    type Options = StrokeTaskOptions;

    fn engine(_options: &StrokeTaskOptions) -> EngineKind {
        EngineKind::Carriage
    }

    fn model(options: &StrokeTaskOptions) -> Result<Model> {
        // There are no servos: an action is a joint's speed.
        let robot = Robot::stroke_leg()?.with_leg_shape("flat")?;
        let mut scene = Scene::flat(Medium::named(&options.medium)?);
        (scene.law, scene.dt) = (options.law, options.dt);
        set_sand(&mut scene, &options.sand)?;
        let model = Model::new(&robot, &scene)?;
        options.stroke.validate(&model)?;
        Ok(model)
    }

    fn new(setup: &Setup<StrokeTaskOptions>) -> Result<Self> {
        let StrokeTaskOptions { max_episode_steps, stroke, .. } = *setup.options;
        let joints = setup.model.robot.joint_names();
        let observation = Features::<Observe>::none()
            .each(&joints, "sine of angle", "1", 1.0, |_, state, _, _, i| state.angles[i].sin())
            .sensed_as(Sensor::JointPosition, Part::Sine)
            .each(&joints, "cosine of angle", "1", 1.0, |_, state, _, _, i| state.angles[i].cos())
            .sensed_as(Sensor::JointPosition, Part::Cosine)
            .each(&joints, "torque", "N·m", TORQUE, |_, state, _, _, i| state.torques[i])
            .sensed(Sensor::JointTorque)
            .each(&joints, "previous action", "1", 1.0, |_, _, action, _, i| action[i].into())
            .one("share of the stroke made", "1", 0.0, 1.0, |task_state, state, _, duration, _| {
                state.position[0] / (task_state.speed * duration)
            })
            .one("thrust impulse so far", "N·s", -IMPULSE, IMPULSE, |_, state, _, _, _| state.impulse[0])
            .one("lift impulse so far", "N·s", -IMPULSE, IMPULSE, |_, state, _, _, _| state.impulse[2])
            .one("work so far", "J", -WORK, WORK, |_, state, _, _, _| state.work);
        let reward: Vec<_> =
            terms(&stroke).into_iter().map(|(name, law, weight, _)| RewardTerm { name, law, weight }).collect();
        let figures = figures();
        let spec = Spec {
            id: Self::ID,
            summary:
                "Find the stroke of one leg through sand with the most thrust for its work; actions are joint speeds."
                    .into(),
            about: ABOUT,
            observation: observation.columns(),
            action: Column::each(&joints, "speed / 1 turn a second", "1", 1.0),
            info: [Column::rewards(&reward), figures.columns()].concat(),
            reward,
            max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        let ranges = setup.model.legs.iter().flatten().map(|b| b.range).collect();
        Ok(Self { spec, observation, figures, ranges, duration: f64::from(max_episode_steps) / CONTROL_RATE })
    }

    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup<StrokeTaskOptions>, random: &mut Random) -> (State, TaskState) {
        let StrokeTaskOptions { stroke, angle_noise: noise, .. } = *setup.options;
        let angles = stroke.start.0.map(|a| a + random.uniform(-noise, noise));
        let mut state = State::at_rest(stroke.height, &angles);
        state.velocity[0] = stroke.carriage_speed;
        (state, TaskState { speed: stroke.carriage_speed, ..TaskState::default() })
    }

    /// Joints with a range stop at its ends.
    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        for (i, a) in action.iter().enumerate() {
            let rate = f64::from(*a) * TOP_SPEED;
            let room = |end: f64| (end - state.angles[i]) * CONTROL_RATE;
            command.rates[i] =
                self.ranges[i].map_or(rate, |[low, high]| rate.max(room(low).min(0.0)).min(room(high).max(0.0)));
        }
    }

    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]) {
        self.observation.fill(row, |value, i| value(task_state, state, last_action, self.duration, i));
    }

    fn evaluate(&self, setup: &Setup<StrokeTaskOptions>, t: &Transition, info: &mut [f32]) -> bool {
        let stroke = &setup.options.stroke;
        let [before, after] = [t.before, t.after].map(|state| self.account(stroke, state));
        // The tolerance is half a step, because the carriage's distance is a sum of many small distances.
        let over = after.progress * self.duration * CONTROL_RATE > f64::from(self.spec.max_episode_steps) - 0.5;
        let left = if over { stroke.deepest(t.model, &t.after.angles) } else { 0.0 };
        let step = StrokeStep { t, before, after, left, duration: self.duration };
        let (rewards, rest) = info.split_at_mut(self.spec.reward.len());
        for (out, (_, _, weight, value)) in rewards.iter_mut().zip(terms(stroke)) {
            *out = (weight * value(&step)) as f32;
        }
        self.figures.fill(rest, |value, _| value(&step));
        over && !t.diverged
    }
}
