//! `sandgait/HexapodTerrain-v1`: HexapodGait where sand, slope, load and motors are drawn for every episode, the sand
//! changes along the way, and the robot is sent back over ground that it has used.

use super::gait::HexapodGait;
use super::ground::{Change, Ground, PATCHES};
use super::options::{Quantity, Randomize, TaskOptions, keywords};
use super::random::Random;
use super::spec::{Column, Spec};
use super::task::{Goal, Setup, Task, Transition};
use crate::error::{Error, Result};
use crate::sand::Medium;
use crate::sim::State;
use crate::sim::engine::Command;
use crate::sim::model::Scene;
use std::sync::Arc;

/// What one episode drew that its model holds.
struct Draw {
    slope_deg: f64,
    payload: f64,
    torque_limit: f64,
}

impl Randomize {
    /// Draws an episode's quantities, always as many numbers in the same order, for a robot with `legs` legs that is told to
    /// go at `speed` [m/s].
    fn draw(&self, options: &TaskOptions, speed: f64, legs: usize, random: &mut Random) -> (Draw, Ground) {
        let difficulty = options.difficulty.unwrap_or(1.0);
        let ranges = self.quantities(options.slope_deg, options.payload).map(|Quantity { range, neutral, .. }| {
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
            outward: if speed < 0.0 { -1.0 } else { 1.0 },
            returning: false,
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
none. Beyond `turning_point` from where it started, in the direction along x of its first command, the commanded speed turns
round, and again when the robot is back, so it walks over its own prints; slipping the other way turns nothing. A clock does not walk backward: give it a far `turning_point`.

**Curriculum.** `difficulty` from 0 to 1 scales the ranges of ζ, slope, payload, motors and κ from nothing to all of
`randomize`; a reset may change both. See HexapodGait-v1 for `control`, for how episodes end, and for the cost of transport.";

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
    pub const ID: &'static str = keywords::TERRAIN.task;

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
        let (draw, ground) = options.randomize.unwrap_or_default().draw(options, goal.speed, legs, random);
        let Scene { slope_deg, payload, .. } = setup.model.scene;
        let mut model = setup.model.with_medium(sand(setup, &ground));
        model.set_load(slope_deg + draw.slope_deg, payload + draw.payload);
        model.weaken_motors(draw.torque_limit);
        (state, Goal { model: Some(Arc::new(model)), ground: Some(ground), ..goal })
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
