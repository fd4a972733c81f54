//! The values that an episode of LeggedVelocity draws when it begins, and the values that it updates.

use super::curriculum::{Followed, MOST_EASE};
use super::draws::{
    ADDED_MASS, Draws, FRICTION, HARD_SHARE, MOST, MOST_COMMAND, MOST_PUSH, MOTOR_STRENGTH, SAND, STRENGTHS,
};
use crate::error::Result;
use crate::random::Random;
use crate::sim::Model;
use crate::spec::CONTROL_RATE;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The curriculum ignores this time at the start of a command [s], as does `sandgait evaluate --commands`; but at most
/// half of the time between two commands. Our choice, because a robot walks steadily after a second.
const BEGINNING: f64 = 2.0;

/// An episode's difficulty.
#[derive(Clone, Copy)]
pub struct Difficulty {
    /// 0 to 1
    pub level: f64,
    /// Factor on the sand's stress, in addition to the drawn factor.
    pub ease: f64,
    /// Factor on commands; the next field is the factor on pushes.
    pub commands: f64,
    pub pushes: f64,
}

impl Difficulty {
    /// The full difficulty, without a curriculum.
    pub const FULL: Self = Self { level: 1.0, ease: 1.0, commands: 1.0, pushes: 1.0 };
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeggedEpisode {
    /// Is the ground hard, though the session's has sand? Only ground `any` is.
    #[serde(default)]
    pub hard: bool,
    /// Factor on the friction of hard ground; the next field is the factor on the sand's stress.
    pub friction: f64,
    pub sand: f64,
    /// [kg]
    pub added_mass: f64,
    /// Factor on torque limits and gains.
    pub motor_strength: f64,
    /// The commands in the order in which the robot gets them: forward, sideways [m/s] and yaw [rad/s].
    pub commands: Vec<[f64; 3]>,
    /// Velocities that pushes give the base along x and y [m/s].
    pub pushes: Vec<[f64; 2]>,
    /// The present command.
    pub now: [f64; 3],
    /// Control steps since the start.
    pub step: u32,
    /// Time for which each foot has been in the air [s].
    pub air: Vec<f64>,
    /// Level of the curriculum, 0 to 1, and how well the robot has followed its commands.
    #[serde(default = "full")]
    pub level: f64,
    #[serde(default)]
    pub followed: Followed,
    /// Velocity averaged over about a stride, if the observation has a clock: forward, to the left [m/s], yaw [rad/s].
    #[serde(default)]
    pub average: [f64; 3],
}

/// The level of an episode without a curriculum.
fn full() -> f64 {
    Difficulty::FULL.level
}

impl LeggedEpisode {
    /// Draws an episode's values. The number and order of the draws are the same for the same options.
    pub fn draw(from: Draws, difficulty: Difficulty, model: &Model, random: &mut Random) -> Self {
        let Draws { commands, rand, .. } = from;
        let counts = from.counts();
        let mut one = |[low, high]: [f64; 2]| random.uniform(low, high);
        let friction = one(rand.friction_range);
        let (hard, strength) = if from.any_ground {
            (one([0.0, 1.0]) < HARD_SHARE, one(STRENGTHS.map(f64::ln)).exp())
        } else {
            (false, 1.0)
        };
        // The curriculum makes sand that is stronger anyway no stronger.
        let sand = one(rand.sand_range) * difficulty.ease.max(strength);
        let added_mass = one(rand.added_mass_range) * model.total_mass();
        let motor_strength = one(rand.motor_strength_range);
        let mut command = || {
            let mut drawn = commands.map(|range| difficulty.commands * one(range));
            if from.single_axis > 0.0 {
                let share = one([0.0, 1.0]) / from.single_axis;
                if share < 1.0 {
                    let axis = (3.0 * share) as usize;
                    drawn = std::array::from_fn(|k| if k == axis { drawn[k] } else { 0.0 });
                }
            }
            let small = drawn[0].hypot(drawn[1]) < from.small;
            if small { [0.0, 0.0, drawn[2]] } else { drawn }
        };
        let all: Vec<_> = (0..counts[0]).map(|_| command()).collect();
        let most = [-rand.max_push_vel_xy, rand.max_push_vel_xy].map(|v| difficulty.pushes * v);
        let pushes = (0..counts[1]).map(|_| [one(most), one(most)]).collect();
        let feet = model.tree.as_ref().map_or(0, |tree| tree.stance.feet.len());
        let now = all.first().copied().unwrap_or_default();
        Self {
            hard,
            friction,
            sand,
            added_mass,
            motor_strength,
            commands: all,
            pushes,
            now,
            step: 0,
            air: vec![0.0; feet],
            level: difficulty.level,
            followed: Followed::default(),
            average: [0.0; 3],
        }
    }

    /// For snapshots: can an episode with the ranges `from` have reached these values? `model`: the session's model.
    pub fn is_sound(&self, from: Draws, model: &Model) -> bool {
        let feet = model.tree.as_ref().map_or(0, |tree| tree.stance.feet.len());
        let most = |x: &f64| x.abs() <= MOST_COMMAND;
        let rand = from.rand;
        // A reset may have changed the ranges since the draw, so the values are compared with the bounds of the options.
        // No foot can be in the air for 1e6 s, because the longest episode takes 2e4 s.
        FRICTION.contains(&self.friction)
            && (*SAND.start()..=SAND.end() * MOST_EASE).contains(&self.sand)
            && (0.0..=1.0).contains(&self.level)
            && self.followed.is_sound()
            && self.average.iter().all(|v| v.is_finite())
            && ADDED_MASS.contains(&(self.added_mass / model.total_mass()))
            && MOTOR_STRENGTH.contains(&self.motor_strength)
            && (1..=MOST).contains(&self.commands.len())
            && self.commands.iter().flatten().chain(&self.now).all(most)
            && self.pushes.len() <= MOST
            && (rand.push_interval == 0.0 || !self.pushes.is_empty())
            && self.pushes.iter().flatten().all(|v| v.abs() <= MOST_PUSH)
            && self.air.len() == feet
            && self.air.iter().all(|t| (0.0..1e6).contains(t))
    }

    /// The model of the session, changed by the drawn values.
    pub fn model(&self, own: &Model) -> Result<Model> {
        let mut model = own.clone();
        let Some(tree) = &model.tree else { return Ok(model) };
        let mut tree = (**tree).clone();
        // Our choice: a light base keeps a tenth of its mass, which stays above 0.
        tree.base_mass = (tree.base_mass + self.added_mass).max(0.1 * tree.base_mass);
        for motor in &mut tree.motors {
            motor.kp *= self.motor_strength;
            motor.kd *= self.motor_strength;
            for torque in [&mut motor.actuator.torque_limit, &mut motor.actuator.stall_torque].into_iter().flatten() {
                *torque *= self.motor_strength;
            }
        }
        model.tree = Some(Arc::new(tree));
        model.scene.medium.coefficients = model.scene.medium.coefficients.scaled(self.sand);
        for piece in &mut model.scene.hard {
            piece.grip *= self.friction;
            if self.hard {
                piece.depth = 0.0;
            }
        }
        Ok(model)
    }

    /// The velocity that tracking terms compare with the command after a step with `velocity`. With a clock of
    /// `frequency` [Hz] it is the average with a time constant of a stride, because a walking robot sways in each
    /// stride; at 0 it is the velocity itself.
    pub fn tracked(&self, velocity: [f64; 3], frequency: f64) -> [f64; 3] {
        let share = Self::share(frequency);
        std::array::from_fn(|k| self.average[k] + share * (velocity[k] - self.average[k]))
    }

    /// Share of a step's velocity in the velocity that is tracked, with a clock of `frequency` [Hz].
    pub fn share(frequency: f64) -> f64 {
        if frequency > 0.0 { (frequency / CONTROL_RATE).min(1.0) } else { 1.0 }
    }

    /// Phase of a clock of `frequency` [Hz] that begins with the episode, in [0, 1).
    pub fn phase(&self, frequency: f64) -> f64 {
        (frequency * (f64::from(self.step) / CONTROL_RATE)).fract()
    }

    /// The command of the present step.
    fn command(&self, from: Draws) -> [f64; 3] {
        let k = (f64::from(self.step) / command_steps(from)) as usize;
        self.commands.get(k % self.commands.len().max(1)).copied().unwrap_or_default()
    }

    /// Updates the episode after a step; returns the push that is due.
    pub fn after_step(&mut self, from: Draws, unit: [f64; 3], seen: &StepFeedback) -> Option<[f64; 2]> {
        for (air, touches) in self.air.iter_mut().zip(seen.feet) {
            *air = if *touches == 1.0 { 0.0 } else { *air + 1.0 / CONTROL_RATE };
        }
        self.average = self.tracked(seen.velocity, seen.clock);
        let every = command_steps(from);
        self.followed.fell |= seen.fell;
        if f64::from(self.step) % every >= (BEGINNING * CONTROL_RATE).min(every / 2.0) {
            self.followed.add(seen.velocity);
        }
        self.step += 1;
        if f64::from(self.step) % every < 1.0 {
            self.followed.end(self.now, unit);
        }
        self.now = self.command(from);
        let interval = from.rand.push_interval;
        let steps = (interval * CONTROL_RATE).round() as u32;
        if steps == 0 || self.pushes.is_empty() || !self.step.is_multiple_of(steps) {
            return None;
        }
        Some(self.pushes[(self.step / steps - 1) as usize % self.pushes.len()])
    }
}

/// What an episode learns from a step.
pub struct StepFeedback<'a> {
    /// 1 for each foot that bears load, else 0.
    pub feet: &'a [f32],
    /// Forward, to the left [m/s] and yaw [rad/s].
    pub velocity: [f64; 3],
    pub fell: bool,
    /// Frequency of the clock in the observation [Hz]; 0: it has none.
    pub clock: f64,
}

/// Time between two commands [control steps].
fn command_steps(from: Draws) -> f64 {
    (from.resampling_time * CONTROL_RATE).max(1.0)
}
