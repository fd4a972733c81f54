//! `sandgait/LegStroke-v0`: the stroke of one leg through sand that gives the most thrust per work.

use super::locomotion::CONTROL_RATE;
use super::options::{StrokeOptions, TaskOptions, keywords};
use super::random::Random;
use super::spec::{Column, Spec, Term};
use super::task::{Goal, Setup, Task, Transition};
use crate::error::{Error, Result};
use crate::sim::State;
use crate::sim::engine::Command;
use std::f64::consts::TAU;

/// Joint speed at action 1 [rad/s]: one turn in the default stroke. A straight leg's tip reaches 0.7 m/s then; resistive
/// force theory is known to hold up to some 0.5 m/s.
const TOP_SPEED: f64 = TAU;

/// Time step [s]: the midpoint rule's efficiencies are within 1 % of those at an eighth of it, which a test holds.
pub const DT: f64 = 4e-3;

/// Control steps of a stroke: 1 s at 50 a second.
pub const STEPS: u32 = 50;

/// Work below this counts as this [J], so that a leg at rest has an efficiency: a hundredth of what good strokes take.
const LEAST_WORK: f64 = 1e-3;

/// Depth of the leg at the end at which the penalty for that is full [m]. Our choice.
const LEFT_DEPTH: f64 = 0.01;

/// Bounds of what is observed, far beyond what good strokes reach on the default sand; what goes beyond is clipped.
const TORQUE: f64 = 10.0; // [N·m]
const IMPULSE: f64 = 20.0; // [N·s]
const WORK: f64 = 20.0; // [J]

const ABOUT: &str = "\
A carriage moves one leg over the sand at a constant speed and height and measures the forces, as the paper's arm does; the
speeds of hip and knee are the action. One stroke is an episode. Forces are those of the sand's law on the leg's 24 segments;
the leg has no mass, so only sand does work on it.

**What is sought**: thrust per work. Thrust is the sand's mean forward force on the leg; work is what both joints
give together, ∫Σ τ ω dt: what goes into the sand and into the carriage. The figure of merit is the *efficiency* of propulsion,

```text
efficiency = thrust impulse [N·s] × carriage speed [m/s] / work [J],
```

the share of that work which pushes the carriage. It is thrust per work times a constant, has no unit, and cannot pass 1:
sand only takes energy. Under a carriage that stands still thrust per work has no greatest value: the sand's forces do not
depend on speed, so the same path at half the speed gives twice the impulse for the same work. A carriage that moves sets the
speed that counts.

**Constraint**: the mean lift over the whole stroke is at least `stroke.lift`, and the leg is out of the sand at the end. What
is missing is paid for. The reward's terms are differences, so that the return is exactly

```text
efficiency − lift_weight · (share of the lift that is missing) − exit_weight · (depth at the end / 1 cm, at most 1)
```

with the efficiency clipped to [−1, 1] and work counted as 1 mJ at least. The episode terminates with the stroke.

**Baseline**: circular strokes: the knee locked, the hip at one speed; the best over knee angle, speed and where it starts
(`stroke.start`).";

pub struct LegStroke {
    spec: Spec,
    /// Of the joints [rad].
    ranges: Vec<Option<[f64; 2]>>,
    /// Length of a stroke [s].
    duration: f64,
}

/// What a stroke has come to.
struct Account {
    /// Thrust impulse × carriage speed / work, in [-1, 1].
    efficiency: f64,
    /// Share of the lift impulse that is still missing; 0 before the stroke begins, so that its terms sum up to the end's.
    missing: f64,
    /// Share of the stroke that is made.
    progress: f64,
}

impl LegStroke {
    pub const ID: &'static str = keywords::STROKE.task;

    pub fn new(setup: &Setup) -> Result<Self> {
        let TaskOptions { max_episode_steps, stroke, .. } = setup.options;
        let stroke = stroke.ok_or_else(|| Error::invalid("stroke", "null is no carriage"))?;
        let joints = setup.model.robot.joint_names();
        let observation = [
            Column::each(&joints, "sine of angle", "1", 1.0),
            Column::each(&joints, "cosine of angle", "1", 1.0),
            Column::each(&joints, "torque", "N·m", TORQUE),
            Column::each(&joints, "previous action", "1", 1.0),
            vec![
                Column::new("share of the stroke made", "1", 0.0, 1.0),
                Column::new("thrust impulse so far", "N·s", -IMPULSE, IMPULSE),
                Column::new("lift impulse so far", "N·s", -IMPULSE, IMPULSE),
                Column::new("work so far", "J", -WORK, WORK),
            ],
        ];
        let reward = vec![
            Term { name: "efficiency", law: "change of: thrust impulse × carriage speed / work", weight: 1.0 },
            Term { name: "lift", law: "−change of: share of the lift impulse missing", weight: stroke.lift_weight },
            Term {
                name: "exit", law: "at the end: −depth of the leg / 1 cm, at least −1", weight: stroke.exit_weight
            },
        ];
        let figures = [
            Column::free("thrust", "N"),
            Column::free("lift", "N"),
            Column::free("work", "J"),
            Column::new("efficiency", "1", -1.0, 1.0),
            Column::free("mean_lift", "N"),
            Column::new("diverged", "1", 0.0, 1.0),
        ];
        let terms = reward.iter().map(|t| Column::free(format!("reward_{}", t.name), "1"));
        let spec = Spec {
            id: Self::ID,
            summary:
                "Find the stroke of one leg through sand that gives the most thrust per work; actions are joint speeds."
                    .into(),
            about: ABOUT,
            observation: observation.concat(),
            action: Column::each(&joints, "speed / 1 turn a second", "1", 1.0),
            info: terms.chain(figures).collect(),
            reward,
            max_episode_steps,
            control_rate: CONTROL_RATE,
        };
        let ranges = setup.model.legs.iter().flatten().map(|b| b.range).collect();
        Ok(Self { spec, ranges, duration: f64::from(max_episode_steps) / CONTROL_RATE })
    }

    /// Of a stroke that has come to `state`. The carriage's way says how much of it is made.
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
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal) {
        let (stroke, noise) = (setup.options.stroke.unwrap_or_default(), setup.options.angle_noise);
        let angles = stroke.start.map(|a| a + random.uniform(-noise, noise));
        let mut state = State::at_rest(stroke.height, &angles);
        state.velocity[0] = stroke.carriage_speed;
        (state, Goal { speed: stroke.carriage_speed, ..Goal::default() })
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

    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]) {
        let joints = state.angles.len();
        for i in 0..joints {
            let (sin, cos) = state.angles[i].sin_cos();
            row[i] = sin as f32;
            row[joints + i] = cos as f32;
            row[2 * joints + i] = state.torques[i] as f32;
            row[3 * joints + i] = last_action[i];
        }
        let made = state.position[0] / (goal.speed * self.duration);
        let [thrust, _, lift] = state.impulse;
        row[4 * joints..].copy_from_slice(&[made, thrust, lift, state.work].map(|x| x as f32));
    }

    fn judge(&self, t: &Transition, info: &mut [f32]) -> bool {
        let stroke = t.options.stroke.unwrap_or_default();
        let [before, after] = [t.before, t.after].map(|state| self.account(&stroke, state));
        // Half a step of room: the carriage's way is a sum of many small ones.
        let over = after.progress * self.duration * CONTROL_RATE > f64::from(self.spec.max_episode_steps) - 0.5;
        let left = if over { stroke.deepest(t.model, &t.after.angles) } else { 0.0 };
        let mean = |i: usize| (t.after.impulse[i] - t.before.impulse[i]) / t.period;
        let row = [
            after.efficiency - before.efficiency,
            stroke.lift_weight * (before.missing - after.missing),
            -stroke.exit_weight * (left / LEFT_DEPTH).min(1.0),
            mean(0),
            mean(2),
            t.after.work - t.before.work,
            after.efficiency,
            t.after.impulse[2] / self.duration,
            f64::from(u8::from(t.diverged)),
        ];
        info.iter_mut().zip(row).for_each(|(out, x)| *out = x as f32);
        over && !t.diverged
    }
}
