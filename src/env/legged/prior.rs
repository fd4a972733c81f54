//! What a plain gait reaches on the ground of an environment: the speeds, from which ranges of commands follow, and the
//! actions, from which a training can start. Meant for robots with six and more legs, which walk without balancing; a
//! trot of four legs must balance, so its plain form says little.

use super::options::driven;
use super::units::Units;
use crate::error::Result;
use crate::sim::engine::{Command, Engine, EngineKind};
use crate::sim::tree::TreeModel;
use crate::sim::tree::plain_gait::{LegStride, PlainGait, StepOrder};
use crate::sim::tree::symmetry::{Sides, Symmetry};
use crate::sim::{Model, State};
use crate::spec::CONTROL_RATE;

/// Fewest legs of a robot that walks without balancing: three stand while three step.
const LEGS: usize = 6;
/// Gaits that are tried: the alternating tripod, and waves in which four or five of six legs stand, as insects walk
/// (Wilson, Annual Review of Entomology 11:103, 1966). Thin legs sink in less with them.
const GAITS: [(StepOrder, f64); 3] =
    [(StepOrder::Alternating, 1.0 / 2.0), (StepOrder::Wave, 2.0 / 3.0), (StepOrder::Wave, 5.0 / 6.0)];
/// Frequencies of a tripod's strides, in units of √(g/ℓ), and heights to which feet are lifted, in lengths ℓ of the legs:
/// our choice. For legs of 12 cm the frequencies are 1.4, 2 and 2.9 Hz. In other gaits a swing takes as long as in a tripod.
const FREQUENCIES: [f64; 3] = [0.16, 0.22, 0.32];
const LIFTS: [f64; 3] = [0.2, 0.4, 0.6];
/// Speeds that the gait is asked for, in units of the default ranges' ends, and the one of these with which strides are compared: our
/// choice.
const ASKED: [f64; 3] = [0.25, 0.5, 1.0];
const COMPARED: f64 = 0.5;
/// The trial, of [`ASKED`], that shows the drift: our choice, the middle one.
const DRIFTS: usize = 1;
/// A wave, or larger steps, must be better than the tripod by this factor: our choice.
const BETTER: f64 = 1.2;
/// Longest stride that is tried if a shorter one is among [`FREQUENCIES`] [s]: our choice, twice the 0.29 s to which the learner's
/// advantages reach, 1/(1 − γλ) steps of 20 ms. A hexapod followed its commands less well with longer ones (docs/learning_hexapods.md).
const LONGEST_STRIDE: f64 = 0.58;
/// Duration of a trial, and its beginning that is not counted [s]: our choice. Whole strides count, after the robot has sunk in.
const SECONDS: f64 = 4.0;
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
    gait: PlainGait,
    pub stride: LegStride,
    /// The ends of the commands' default ranges forward, to the left [m/s] and yaw [rad/s].
    ends: [f64; 3],
    /// The greatest speeds that it reaches along each axis, the mean of both directions, at least [`LEAST`] of `ends`.
    pub reached: [f64; 3],
    /// What it reaches along each of [`DIRECTIONS`] if it is asked for [`ASKED`] of `ends`. It slips, and its joints come to their ends.
    curves: [[f64; ASKED.len()]; DIRECTIONS.len()],
    /// What it does besides when it moves along each of [`DIRECTIONS`]: velocities for each unit of speed along it. A gait to the side
    /// may also turn.
    drifts: [[f64; 3]; DIRECTIONS.len()],
    /// The speed forward that it really reaches, if that is less than `reached` [m/s].
    pub slow: Option<f64>,
    /// How well it walks: the sum of the speeds that it really reaches along all directions, in units of `ends`.
    score: f64,
    /// The joint of each action, and the offset of its target at action 1 [rad].
    driven: Vec<(usize, f64)>,
    joints: usize,
}

/// An axis (forward, to the left, yaw) and the sign of the velocity along it.
type Direction = (usize, f64);
/// All directions. Robots differ in front and back, and many files in left and right.
const DIRECTIONS: [Direction; 6] = [(0, 1.0), (1, 1.0), (2, 1.0), (0, -1.0), (1, -1.0), (2, -1.0)];
/// The directions with which strides are compared.
const FIRST: usize = 3;

/// The index in [`DIRECTIONS`] of a velocity along `axis`.
fn direction(axis: usize, velocity: f64) -> usize {
    if velocity < 0.0 { axis + FIRST } else { axis }
}

/// A stride, and the speed that it is asked for, in units of the default ranges' ends.
type Trial = (LegStride, f64);

impl GaitPrior {
    /// Tries strides with the robot of `model` on its ground; `action_scale` is the option, `legs`: do actions move the joints of
    /// legs alone, `clock` the strides in a second, if they are given [Hz]. None: the robot has fewer than six legs, or an odd
    /// number.
    pub fn of(model: &Model, action_scale: Option<f64>, legs: bool, clock: Option<f64>) -> Result<Option<Self>> {
        let Some(tree) = &model.tree else { return Ok(None) };
        let Some(gait) = PlainGait::of(tree).filter(|_| tree.stance.legs.len() >= LEGS) else { return Ok(None) };
        let ends = Units::of(model).commanded();
        let strides = strides(model, tree, &gait, clock);
        let (stride, driven) = (strides[0], driven(tree, action_scale, legs).by_actions);
        let (curves, drifts) = ([[0.0; ASKED.len()]; DIRECTIONS.len()], [[0.0; 3]; DIRECTIONS.len()]);
        let joints = tree.joints();
        let mut own =
            Self { gait, stride, ends, reached: [0.0; 3], curves, drifts, slow: None, score: 0.0, driven, joints };
        let compared: Vec<Trial> = strides.iter().map(|stride| (*stride, COMPARED)).collect();
        let all = own.trials(model, tree, &compared, &DIRECTIONS[..FIRST])?;
        let score = |k: usize| {
            own.score(&std::array::from_fn(|axis| all[k][axis][axis]))
                * if strides[k].order == StepOrder::Alternating { BETTER } else { 1.0 }
        };
        let best = (0..strides.len()).max_by(|a, b| score(*a).total_cmp(&score(*b))).unwrap_or(0);
        own.stride = strides[best];
        let mut reached = own.trials(model, tree, &ASKED.map(|share| (own.stride, share)), &DIRECTIONS)?;
        if let Ok(symmetry) = Symmetry::of(tree) {
            reached.iter_mut().for_each(|velocities| make_symmetric(velocities, symmetry.sides));
        }
        let along = |d: usize, velocity: [f64; 3]| (DIRECTIONS[d].1 * velocity[DIRECTIONS[d].0]).max(0.0);
        own.curves = std::array::from_fn(|d| std::array::from_fn(|i| along(d, reached[i][d])));
        own.drifts = std::array::from_fn(|d| own.drift(d, reached[DRIFTS][d]));
        let along = own.curves.map(|curve| curve.into_iter().fold(0.0, f64::max));
        let most: [f64; FIRST] = std::array::from_fn(|k| 0.5 * (along[k] + along[k + FIRST]));
        own.score = own.score(&most);
        own.reached = std::array::from_fn(|k| most[k].max(LEAST * ends[k]));
        own.slow = Some(most[0]).filter(|speed| *speed < own.reached[0]);
        Ok(Some(own))
    }

    /// The sum of these speeds along the axes, in units of the default ranges' ends.
    fn score(&self, reached: &[f64; 3]) -> f64 {
        (0..3).map(|k| (reached[k] / self.ends[k]).clamp(0.0, 1.0)).sum()
    }

    /// Velocities for each unit of speed along `direction` when it walks with `velocity`; in units of the default ranges' ends at most
    /// as fast as along the direction.
    fn drift(&self, direction: usize, velocity: [f64; 3]) -> [f64; 3] {
        let (axis, sign) = DIRECTIONS[direction];
        let speed = sign * velocity[axis];
        if speed <= 0.0 {
            return [0.0; 3];
        }
        let relative = |k: usize| (velocity[k] / self.ends[k] / (speed / self.ends[axis])).clamp(-1.0, 1.0);
        std::array::from_fn(|k| if k == axis { 0.0 } else { relative(k) * self.ends[k] / self.ends[axis] })
    }

    /// Does it walk clearly better than `other`?
    pub fn is_better_than(&self, other: &Self) -> bool {
        self.score > BETTER * other.score
    }

    /// The greatest speeds forward, to the left [m/s] and yaw [rad/s] that suit robot and ground: somewhat more than the
    /// gait reaches, but not above the default ranges' ends. Turning is slowed down as much as walking, so curves keep
    /// their radius.
    pub fn speeds(&self) -> [f64; 3] {
        let share = |k: usize| (FASTER * self.reached[k] / self.ends[k]).min(1.0);
        let [x, y, yaw] = self.ends;
        [share(0) * x, share(1) * y, share(0) * yaw].map(rounded)
    }

    /// Fills `action` with the gait's action at `phase` of a stride, 0 to 1, under `command`.
    pub fn action(&self, command: [f64; 3], phase: f64, action: &mut [f32]) {
        let along = |axis: usize| self.drifts[direction(axis, command[axis])];
        let drift = |k: usize| (0..3).map(|axis| along(axis)[k] * command[axis].abs()).sum::<f64>();
        let fed = std::array::from_fn(|k| self.asked(k, command[k] - drift(k)));
        let size = (0..3).map(|k| (command[k] / self.reached[k]).powi(2)).sum::<f64>().sqrt();
        let lift = self.stride.lift * (size / SLOW).min(1.0);
        self.fill(LegStride { lift, ..self.stride }, fed, phase, action);
    }

    /// What the gait must be asked for to reach a velocity along axis `k`, see [`Self::asked_along`].
    fn asked(&self, k: usize, velocity: f64) -> f64 {
        self.asked_along(direction(k, velocity), velocity.abs()).copysign(velocity)
    }

    /// What the gait must be asked for to reach a speed along a direction, from the straight lines between the trials; as much as it
    /// is asked for at its greatest speed, if the speed is beyond it.
    fn asked_along(&self, direction: usize, speed: f64) -> f64 {
        let (k, mut before) = (direction % FIRST, [0.0; 2]);
        for (share, reached) in ASKED.into_iter().zip(self.curves[direction]).filter(|(_, reached)| *reached > 0.0) {
            let now = [share * self.ends[k], reached];
            if now[1] >= speed {
                let part = ((speed - before[1]) / (now[1] - before[1]).max(1e-9)).clamp(0.0, 1.0);
                return before[0] + part * (now[0] - before[0]);
            }
            if now[1] > before[1] {
                before = now;
            }
        }
        if before[0] > 0.0 { before[0] } else { self.ends[k] * speed / self.reached[k] }
    }

    fn fill(&self, stride: LegStride, velocity: [f64; 3], phase: f64, action: &mut [f32]) {
        let mut offsets = vec![0.0; self.joints];
        self.gait.offsets(stride, velocity, phase, &mut offsets);
        for (action, (joint, scale)) in action.iter_mut().zip(&self.driven) {
            *action = (offsets[*joint] / scale).clamp(-1.0, 1.0) as f32;
        }
    }

    /// For each trial and each direction, the robot's mean velocity forward, to the left and in yaw when it is asked for the trial's
    /// speed in this direction; 0 if the state has lost its bounds.
    fn trials(
        &self,
        model: &Model,
        tree: &TreeModel,
        trials: &[Trial],
        along: &[Direction],
    ) -> Result<Vec<Vec<[f64; 3]>>> {
        let angles = &tree.stance.angles;
        let mut start = State::at_rest(tree.height_over(angles, |x, y| model.surface_height(x, y)), angles);
        start.references.copy_from_slice(angles);
        let count = along.len() * trials.len();
        let mut engine = Engine::new(EngineKind::Tree, model, count)?;
        (0..count).for_each(|i| engine.set_state(i, &start));
        let substeps = (1.0 / (CONTROL_RATE * model.scene.dt)).round().max(1.0) as usize;
        let (mut sums, mut state) = (vec![[0.0; 3]; count], start.clone());
        let (mut command, mut action) = (Command::still(self.joints), vec![0.0; self.driven.len()]);
        let steps = (SECONDS * CONTROL_RATE) as usize;
        let counted = |frequency: f64| {
            let (longest, stride) = (SECONDS - BEGINNING, frequency.recip());
            let whole = if stride < longest { (longest / stride).floor() * stride } else { longest };
            (whole * CONTROL_RATE).round() as usize
        };
        for step in 0..steps {
            for i in 0..count {
                let ((stride, share), (axis, sign)) = (trials[i / along.len()], along[i % along.len()]);
                let mut velocity = [0.0; 3];
                velocity[axis] = sign * share * self.ends[axis];
                self.fill(stride, velocity, stride.frequency * step as f64 / CONTROL_RATE, &mut action);
                command.targets.clear();
                command.targets.extend_from_slice(angles);
                for ((joint, scale), part) in self.driven.iter().zip(&action) {
                    command.targets[*joint] += scale * f64::from(*part);
                }
                engine.command(i, &command);
            }
            engine.advance(substeps);
            for (i, sum) in sums.iter_mut().enumerate() {
                let counted = counted(trials[i / along.len()].0.frequency);
                if step + counted < steps {
                    continue;
                }
                engine.state(i, &mut state);
                let [x, y, _] = state.to_body(state.velocity);
                let velocity = [x, y, state.to_body(state.angular_velocity)[2]];
                let share = if state.is_sound() { 1.0 / counted as f64 } else { f64::NAN };
                sum.iter_mut().zip(velocity).for_each(|(sum, v)| *sum += share * v);
            }
        }
        let sound = |sum: &[f64; 3]| if sum.iter().all(|v| v.is_finite()) { *sum } else { [0.0; 3] };
        Ok(sums.chunks_exact(along.len()).map(|sums| sums.iter().map(sound).collect()).collect())
    }
}

/// Replaces the velocities along [`DIRECTIONS`] of a symmetric robot by means with their mirror images: a trial begins with one group
/// of legs, so it is not quite symmetric.
fn make_symmetric(velocities: &mut [[f64; 3]], sides: Sides) {
    let sign = |axis: usize| if axis == sides.across() || axis == 2 { -1.0 } else { 1.0 };
    let before = velocities.to_vec();
    for (d, velocity) in velocities.iter_mut().enumerate() {
        let image = if sign(d % FIRST) < 0.0 { (d + FIRST) % DIRECTIONS.len() } else { d };
        *velocity = std::array::from_fn(|k| 0.5 * (before[d][k] + sign(k) * before[image][k]));
    }
}

/// The strides that are tried. A wave runs from back to front, so it suits robots whose front is along x.
fn strides(model: &Model, tree: &TreeModel, gait: &PlainGait, clock: Option<f64>) -> Vec<LegStride> {
    let rate = Units::of(model).rate;
    let along_y = Symmetry::of(tree).is_ok_and(|own| own.sides != Sides::LeftRight);
    let mut all = Vec::new();
    for (order, duty_factor) in GAITS {
        if order == StepOrder::Wave && (along_y || !gait.has_wave()) {
            continue;
        }
        let slower = (1.0 - duty_factor) / (1.0 - GAITS[0].1);
        let usual = || FREQUENCIES.iter().map(|f| rounded(f * rate * slower)).collect();
        for frequency in clock.map_or_else(usual, |given| vec![given]) {
            let lifted = |lift: f64| LegStride { order, duty_factor, frequency, lift: lift * tree.stance.leg_length };
            all.extend(LIFTS.map(lifted));
        }
    }
    let short = |stride: &LegStride| stride.frequency * LONGEST_STRIDE >= 1.0;
    if all.iter().any(short) {
        all.retain(short);
    }
    all
}
