//! What a plain gait reaches on the ground of an environment: the speeds, from which ranges of commands follow, and the
//! actions, from which a training can start. Meant for robots with six and more legs, which walk without balancing; a
//! trot of four legs must balance, so its plain form says little.

use super::options::driven;
use super::units::Units;
use crate::error::Result;
use crate::sim::engine::{Command, Engine, EngineKind};
use crate::sim::tree::TreeModel;
use crate::sim::tree::alternating::{AlternatingGait, LegStride};
use crate::sim::{Model, State};
use crate::spec::CONTROL_RATE;

/// Fewest legs of a robot that walks without balancing: three stand while three step.
const LEGS: usize = 6;
/// Frequencies of strides that are tried, in units of √(g/ℓ), and heights to which feet are lifted, in lengths ℓ of the legs:
/// our choice. For legs of 12 cm the frequencies are 1.4, 2 and 2.9 Hz.
const FREQUENCIES: [f64; 3] = [0.16, 0.22, 0.32];
const LIFTS: [f64; 2] = [0.2, 0.4];
/// Duration of a trial, and its beginning that is not counted [s]: our choice, three strides or more after the robot has
/// sunk in.
const SECONDS: f64 = 3.0;
const BEGINNING: f64 = 1.0;
/// A speed counts as at least this part of the speed that was asked: our choice. The plain gait may go badly where
/// another one does not, and commands near zero teach nothing.
pub const LEAST: f64 = 0.25;
/// A learnt gait is faster than the plain one by this factor: clocks that CMA-ES found walk 1.23 to 1.32 times as fast as the
/// fastest tripod (docs/learning_results.md); our choice is a little less.
const FASTER: f64 = 1.2;
/// Length of a command, in units of the greatest speeds, from which on feet are lifted fully: our choice.
const SLOW: f64 = 0.25;

/// With two digits, so that it reads well.
fn rounded(x: f64) -> f64 {
    (x * 1e2).round().max(1.0) / 1e2
}

/// The plain gait of a robot on a ground.
#[derive(Clone, Debug, PartialEq)]
pub struct GaitPrior {
    gait: AlternatingGait,
    pub stride: LegStride,
    /// Speeds forward, to the left [m/s] and yaw [rad/s] that the gait is asked for, and what it reaches then.
    pub asked: [f64; 3],
    pub reached: [f64; 3],
    /// The speed forward that it really reaches, if that is less than `reached` [m/s].
    pub slow: Option<f64>,
    /// The joint of each action, and the offset of its target at action 1 [rad].
    driven: Vec<(usize, f64)>,
    joints: usize,
}

impl GaitPrior {
    /// Tries strides with the robot of `model` on its ground; `action_scale` is the option, `legs`: do actions move the joints of
    /// legs alone, `clock` the strides in a second, if they are given [Hz]. None: the robot has fewer than six legs, or an odd
    /// number.
    pub fn of(model: &Model, action_scale: Option<f64>, legs: bool, clock: Option<f64>) -> Result<Option<Self>> {
        let Some(tree) = &model.tree else { return Ok(None) };
        let Some(gait) = AlternatingGait::of(tree).filter(|_| tree.stance.legs.len() >= LEGS) else { return Ok(None) };
        let driven = driven(tree, action_scale, legs).by_actions;
        let units = Units::of(model);
        let asked = units.commanded();
        let usual = FREQUENCIES.map(|f| rounded(f * units.rate));
        let frequencies = clock.map_or(usual.to_vec(), |given| vec![given]);
        let stride = |frequency: f64, lift: f64| LegStride { frequency, lift: lift * tree.stance.leg_length };
        let strides: Vec<LegStride> = frequencies.iter().flat_map(|f| LIFTS.map(|lift| stride(*f, lift))).collect();
        let (stride, reached, joints) = (strides[0], [0.0; 3], tree.joints());
        let mut own = Self { gait, stride, asked, reached, slow: None, driven, joints };
        let all = own.trials(model, tree, &strides)?;
        let share = |reached: &[f64; 3]| (0..3).map(|k| (reached[k] / asked[k]).clamp(0.0, 1.0)).sum::<f64>();
        let best = strides.iter().zip(all).max_by(|a, b| share(&a.1).total_cmp(&share(&b.1)));
        if let Some((stride, reached)) = best {
            (own.stride, own.reached) = (*stride, std::array::from_fn(|k| reached[k].max(LEAST * asked[k])));
            own.slow = Some(reached[0]).filter(|speed| *speed < own.reached[0]);
        }
        Ok(Some(own))
    }

    /// The greatest speeds forward, to the left [m/s] and yaw [rad/s] that suit robot and ground: somewhat more than the
    /// gait reaches, but not above the default ranges' ends. Turning is slowed down as much as walking, so curves keep
    /// their radius.
    pub fn speeds(&self) -> [f64; 3] {
        let share = |k: usize| (FASTER * self.reached[k] / self.asked[k]).min(1.0);
        let [x, y, yaw] = self.asked;
        [share(0) * x, share(1) * y, share(0) * yaw].map(rounded)
    }

    /// Fills `action` with the gait's action at `phase` of a stride, 0 to 1, under `command`.
    pub fn action(&self, command: [f64; 3], phase: f64, action: &mut [f32]) {
        // The gait slips, so it is asked for more than the command.
        let fed = std::array::from_fn(|k| command[k] * self.asked[k] / self.reached[k].min(self.asked[k]));
        let size = (0..3).map(|k| (command[k] / self.reached[k]).powi(2)).sum::<f64>().sqrt();
        let lift = self.stride.lift * (size / SLOW).min(1.0);
        self.fill(LegStride { lift, ..self.stride }, fed, phase, action);
    }

    fn fill(&self, stride: LegStride, velocity: [f64; 3], phase: f64, action: &mut [f32]) {
        let mut offsets = vec![0.0; self.joints];
        self.gait.offsets(stride, velocity, phase, &mut offsets);
        for (action, (joint, scale)) in action.iter_mut().zip(&self.driven) {
            *action = (offsets[*joint] / scale).clamp(-1.0, 1.0) as f32;
        }
    }

    /// The speed along each direction that is reached with each stride when the robot is asked for the greatest speed in
    /// this direction.
    fn trials(&self, model: &Model, tree: &TreeModel, strides: &[LegStride]) -> Result<Vec<[f64; 3]>> {
        let angles = &tree.stance.angles;
        let mut start = State::at_rest(tree.height_over(angles, |x, y| model.surface_height(x, y)), angles);
        start.references.copy_from_slice(angles);
        let count = 3 * strides.len();
        let mut engine = Engine::new(EngineKind::Tree, model, count)?;
        (0..count).for_each(|i| engine.set_state(i, &start));
        let substeps = (1.0 / (CONTROL_RATE * model.scene.dt)).round().max(1.0) as usize;
        let (mut sums, mut state) = (vec![0.0; count], start.clone());
        let (mut command, mut action) = (Command::still(self.joints), vec![0.0; self.driven.len()]);
        let (steps, first) = ((SECONDS * CONTROL_RATE) as usize, (BEGINNING * CONTROL_RATE) as usize);
        for step in 0..steps {
            for i in 0..count {
                let (stride, mut velocity) = (strides[i / 3], [0.0; 3]);
                velocity[i % 3] = self.asked[i % 3];
                self.fill(stride, velocity, stride.frequency * step as f64 / CONTROL_RATE, &mut action);
                command.targets.clear();
                command.targets.extend_from_slice(angles);
                for ((joint, scale), part) in self.driven.iter().zip(&action) {
                    command.targets[*joint] += scale * f64::from(*part);
                }
                engine.command(i, &command);
            }
            engine.advance(substeps);
            for (i, sum) in sums.iter_mut().enumerate().filter(|_| step >= first) {
                engine.state(i, &mut state);
                let [x, y, _] = state.to_body(state.velocity);
                let own = [x, y, state.to_body(state.angular_velocity)[2]][i % 3];
                *sum += if state.is_sound() { own / (steps - first) as f64 } else { f64::NEG_INFINITY };
            }
        }
        Ok(sums.chunks_exact(3).map(|s| std::array::from_fn(|k| s[k].max(0.0))).collect())
    }
}
