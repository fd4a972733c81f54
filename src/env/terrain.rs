//! `sandgait/HexapodTerrain-v0`: HexapodGait where sand, slope, load and motors are drawn for every episode, the sand
//! changes along the way, and the robot is sent back over ground that it has used.

use super::gait::HexapodGait;
use super::ground::{Change, Ground, PATCHES};
use super::options::TaskOptions;
use super::random::Random;
use super::spec::{Column, Spec};
use super::task::{Goal, Setup, Task, Transition};
use crate::error::{Error, Result, check_range};
use crate::sand::Medium;
use crate::sim::engine::Command;
use crate::sim::model::Scene;
use crate::sim::{Model, Robot, State};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Ranges [low, high] that an episode's quantities are drawn from, uniformly; changes to what the other options say.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Randomize {
    /// ζ of each patch over the medium's own. Our choice: on poppy seeds from plastic pellets to twice as stiff as close
    /// packing makes them; batches alone differ by 20-40 % (Li, Zhang & Goldman 2013).
    pub zeta: [f64; 2],
    /// Length of a patch along x [m]. Our choice: one to four body lengths.
    pub patch_length: [f64; 2],
    /// Added to `slope_deg` [°]. Our choice.
    pub slope_deg: [f64; 2],
    /// Added to `payload` [kg]. Our choice: up to a third of the robot's mass.
    pub payload: [f64; 2],
    /// Share of `torque_limit` that the motors have. Our choice.
    pub torque_limit: [f64; 2],
    /// κ of re-used ground; see mechanism `footprint`. Our choice: no published law found.
    pub footprint: [f64; 2],
    /// Distance after which the robot is sent back, and again when it is back at the start [m]. Our choice.
    pub turning_point: [f64; 2],
}

impl Default for Randomize {
    fn default() -> Self {
        Self {
            zeta: [0.45, 2.0],
            patch_length: [0.15, 0.6],
            slope_deg: [-10.0, 10.0],
            payload: [0.0, 0.05],
            torque_limit: [0.4, 1.0],
            footprint: [0.0, 0.5],
            turning_point: [0.3, 1.2],
        }
    }
}

/// What one episode drew that its model holds.
struct Draw {
    slope_deg: f64,
    payload: f64,
    torque_limit: f64,
}

/// One quantity that is drawn.
struct Quantity {
    name: &'static str,
    /// What an episode draws from.
    range: [f64; 2],
    /// What the range must lie in.
    guard: [f64; 2],
    /// The value that leaves everything as the other options say, if `difficulty` scales the range.
    neutral: Option<f64>,
}

impl Randomize {
    fn quantities(&self, options: &TaskOptions) -> [Quantity; 7] {
        let slope = [-35.0, 35.0].map(|most| most - options.slope_deg);
        let quantity = |name, range, guard, neutral| Quantity { name, range, guard, neutral };
        [
            quantity("zeta", self.zeta, [0.1, 10.0], Some(1.0)),
            quantity("patch_length", self.patch_length, [0.02, 100.0], None),
            quantity("slope_deg", self.slope_deg, slope, Some(0.0)),
            quantity("payload", self.payload, [0.0, 10.0], Some(0.0)),
            quantity("torque_limit", self.torque_limit, [0.01, 1.0], Some(1.0)),
            quantity("footprint", self.footprint, [-2.0, 1.0], Some(0.0)),
            quantity("turning_point", self.turning_point, [0.05, 1e3], None),
        ]
    }

    pub fn validate(&self, options: &TaskOptions) -> Result<()> {
        for Quantity { name, range: [low, high], guard: [least, most], .. } in self.quantities(options) {
            check_range(&format!("randomize.{name}[0]"), low, least..=most)?;
            check_range(&format!("randomize.{name}[1]"), high, low..=most)?;
        }
        Ok(())
    }

    /// Draws an episode's quantities, always as many numbers in the same order, for a robot with `legs` legs.
    fn draw(&self, options: &TaskOptions, difficulty: f64, legs: usize, random: &mut Random) -> (Draw, Ground) {
        let ranges = self.quantities(options).map(|Quantity { range, neutral, .. }| {
            range.map(|end| neutral.map_or(end, |neutral| neutral + difficulty * (end - neutral)))
        });
        let [zeta, patch_length, slope_deg, payload, torque_limit, footprint, turning_point] = ranges;
        let mut one = |[low, high]: [f64; 2]| random.uniform(low, high);
        let draw = Draw { slope_deg: one(slope_deg), payload: one(payload), torque_limit: one(torque_limit) };
        let ground = Ground {
            patch_length: one(patch_length),
            footprint: one(footprint),
            turning_point: one(turning_point),
            zeta: (0..PATCHES).map(|_| one(zeta)).collect(),
            patch: 0,
            standing: vec![None; legs],
            footing: vec![1.0; legs],
            returning: 0.0,
            prints: Vec::new(),
        };
        (draw, ground)
    }
}

const ABOUT: &str = "\
HexapodGait on ground that nobody has told the policy about. At every reset the quantities in `randomize` are drawn from the
episode's own random numbers and stand in `info` at every step; they change what the other options say (`zeta` and
`torque_limit` multiply, `slope_deg` and `payload` add).

**Media change along the way.** The bed is cut into patches of one length, each with a ζ of its own; after 16 patches they
repeat. The sand in force is that of the patch under the base's centre, for all legs, and changes between control steps:
patches are no shorter than the robot by default, and the engine holds one sand a robot.

**Ground is remembered.** Where a leg's tip went into the sand it leaves a print when it comes out; a leg that goes in at the
distance d from the nearest print finds, for as long as it stands, 1 − κ e^(−d/3 cm) of fresh ground's stress (mechanism
`footprint`; `info` has the mean over legs as `footing`). The last 512 prints count, whichever leg made them. The belly leaves
none. Beyond `turning_point` from where it started, the commanded speed turns round, and again when the robot is back, so it
walks over its own prints. A clock does not walk backward: give it a far `turning_point`.

**Curriculum.** `difficulty` from 0 to 1 scales the ranges of ζ, slope, payload, motors and κ from nothing to all of
`randomize`; a reset may change both. See HexapodGait-v0 for `control`, for how episodes end, and for the cost of transport.";

/// The task; what it shares with HexapodGait is that task's own.
pub struct HexapodTerrain {
    gait: HexapodGait,
    spec: Spec,
}

/// Info columns beyond HexapodGait's.
const DRAWN: [(&str, &str); 9] = [
    ("difficulty", "1"),
    ("zeta", "1"),
    ("patch_length", "m"),
    ("slope_deg", "°"),
    ("payload", "kg"),
    ("torque_limit", "N·m"),
    ("footprint", "1"),
    ("turning_point", "m"),
    ("footing", "1"),
];

impl HexapodTerrain {
    pub const ID: &'static str = "sandgait/HexapodTerrain-v0";

    pub fn new(setup: &Setup) -> Result<Self> {
        if setup.options.randomize.is_none() {
            return Err(Error::invalid("randomize", "null is no set of ranges"));
        }
        let gait = HexapodGait::new(setup)?;
        let mut spec = gait.spec().clone();
        spec.id = Self::ID;
        spec.about = ABOUT;
        spec.summary = spec.summary.replace("on sand", "over sand that changes and remembers");
        spec.info.extend(DRAWN.map(|(name, unit)| Column::free(name, unit)));
        Ok(Self { gait, spec })
    }
}

/// The robot and scene of `setup`'s options with what an episode drew.
fn drawn(setup: &Setup, draw: &Draw) -> (Robot, Scene) {
    let (mut robot, mut scene) = (setup.model.robot.clone(), setup.model.scene.clone());
    robot.servo.torque_limit = robot.servo.torque_limit.map(|limit| limit * draw.torque_limit);
    scene.slope_deg += draw.slope_deg;
    scene.payload += draw.payload;
    (robot, scene)
}

/// The sand of the patch in force.
fn sand(setup: &Setup, ground: &Ground) -> Medium {
    let own = &setup.model.scene.medium;
    Medium { coefficients: own.coefficients.scaled(ground.zeta[ground.patch]), ..own.clone() }
}

impl Task for HexapodTerrain {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal) {
        let (state, goal) = self.gait.begin(setup, random);
        let (options, legs) = (&setup.options, setup.model.legs.len());
        let difficulty = options.difficulty.unwrap_or(1.0);
        let (draw, ground) = options.randomize.unwrap_or_default().draw(options, difficulty, legs, random);
        let (robot, mut scene) = drawn(setup, &draw);
        scene.medium = sand(setup, &ground);
        // What `draw` makes is within every range that was checked with the options.
        let model = Model::new(&robot, &scene).map_or_else(|_| setup.model.clone(), Arc::new);
        (state, Goal { model: Some(model), ground: Some(ground), ..goal })
    }

    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        self.gait.command(action, state, command);
    }

    /// Prints, patches, and the way back.
    fn walked(&self, setup: &Setup, goal: &mut Goal, state: &State) -> Change {
        let (Some(ground), Some(model)) = (&mut goal.ground, &mut goal.model) else { return Change::Nothing };
        let change = ground.walked(model, state);
        if change == Change::Patch {
            *model = Arc::new(model.with_medium(sand(setup, ground)));
        }
        if ground.turned(state.position[0]) {
            goal.speed = -goal.speed;
        }
        change
    }

    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]) {
        self.gait.observe(goal, state, last_action, row);
    }

    fn judge(&self, t: &Transition, info: &mut [f32]) -> bool {
        let (walk, drawn) = info.split_at_mut(self.gait.spec().info.len());
        if let Some(ground) = &t.goal.ground {
            let (scene, own) = (&t.model.scene, t.options);
            let footing = ground.footing.iter().sum::<f64>() / ground.footing.len() as f64;
            let figures = [
                own.difficulty.unwrap_or(1.0),
                ground.zeta[ground.patch],
                ground.patch_length,
                scene.slope_deg,
                scene.payload,
                t.model.motor.torque_limit,
                ground.footprint,
                ground.turning_point,
                footing,
            ];
            drawn.iter_mut().zip(figures).for_each(|(out, x)| *out = x as f32);
        }
        self.gait.judge(t, walk)
    }
}
