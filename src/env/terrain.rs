//! `sandgait/HexapodTerrain-v1`: HexapodGait with sand, slope, load and motors drawn for every episode. The sand varies
//! with position, and the command makes the robot walk back over its own footprints.

use super::feature::Features;
use super::gait::{GaitOptions, HexapodGait};
use super::ground::{Change, PATCHES, UsedGround};
use super::random::Random;
use super::spec::Spec;
use super::task::{Setup, Task, TaskState, Transition};
use crate::error::{Error, Result, check_range};
use crate::options;
use crate::sand::Medium;
use crate::sim::engine::{Command, EngineKind};
use crate::sim::model::Scene;
use crate::sim::{Model, State};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

options! {
    /// Options of HexapodTerrain.
    pub struct TerrainOptions {
        ..gait: GaitOptions = GaitOptions::default();
        randomize: Randomize = Randomize::default(), reset, "ranges [low, high] of the quantities that an episode draws; they modify other options";
        difficulty: f64 = 1.0, [0.0, 1.0], reset, "share of the ranges in randomize, from 0 (nothing varies) to 1";
    }
}

options! {
    /// Ranges [low, high] that an episode's quantities are drawn from, uniformly. `zeta`: our choice; relative to
    /// loosely packed poppy seeds, from plastic pellets to 1.1 times closely packed seeds. Batches of one medium differ
    /// by 20-40 % (Li, Zhang & Goldman 2013). The other ranges are also our choice: patches of one to four body
    /// lengths, payloads of up to a third of the robot's mass, slopes on which a policy from flat ground follows speeds
    /// badly (docs/learning_results.md), motors that keep twice the rms torque of a 2 Hz walk, turning points after two to
    /// eight body lengths; we found no published law for `footprint`. [`Randomize::quantities`] has the bounds.
    #[derive(Copy, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Randomize {
        zeta: [f64; 2] = [0.45, 2.0], reset, "factor on the medium's ζ, for each patch";
        patch_length: [f64; 2] = [0.15, 0.6], reset, "length of a patch along x [m]";
        slope_deg: [f64; 2] = [-10.0, 10.0], reset, "angle added to slope_deg [°]";
        payload: [f64; 2] = [0.0, 0.05], reset, "mass added to payload [kg]";
        torque_limit: [f64; 2] = [0.4, 1.0], reset, "factor on torque_limit";
        footprint: [f64; 2] = [0.0, 0.5], reset, "κ of re-used ground, as in mechanism footprint";
        turning_point: [f64; 2] = [0.3, 1.2], reset, "distance from the start at which the commanded speed changes its sign; it changes again when the robot is back [m]";
    }
}

/// One drawn quantity.
struct TerrainQuantity {
    name: &'static str,
    /// The range that an episode draws from.
    range: [f64; 2],
    /// Bounds of the range: our choice, far beyond useful values; no length, ζ or torque is 0.
    guard: [f64; 2],
    /// The value that changes nothing, if `difficulty` scales the range.
    neutral: Option<f64>,
}

impl Randomize {
    /// All quantities. `slope_deg` [°] and `payload` [kg] are the options to which drawn values are added; the sums
    /// stay within a scene's bounds.
    fn quantities(&self, slope_deg: f64, payload: f64) -> [TerrainQuantity; 7] {
        let slope = [-Scene::MAX_SLOPE_DEG, Scene::MAX_SLOPE_DEG].map(|most| most - slope_deg);
        let load = [0.0, (Scene::MAX_PAYLOAD - payload).min(10.0)];
        let quantity = |name, range, guard, neutral| TerrainQuantity { name, range, guard, neutral };
        [
            quantity("zeta", self.zeta, [0.1, 10.0], Some(1.0)),
            quantity("patch_length", self.patch_length, [0.02, 100.0], None),
            quantity("slope_deg", self.slope_deg, slope, Some(0.0)),
            quantity("payload", self.payload, load, Some(0.0)),
            quantity("torque_limit", self.torque_limit, [0.01, 1.0], Some(1.0)),
            quantity("footprint", self.footprint, [-2.0, 1.0], Some(0.0)),
            quantity("turning_point", self.turning_point, [0.05, 1e3], None),
        ]
    }

    /// The arguments are those of [`Self::quantities`].
    fn validate(&self, slope_deg: f64, payload: f64) -> Result<()> {
        for TerrainQuantity { name, range: [low, high], guard: [least, most], .. } in
            self.quantities(slope_deg, payload)
        {
            let added = match name {
                "slope_deg" => format!(" (it is added to slope_deg = {slope_deg})"),
                "payload" => format!(" (it is added to payload = {payload})"),
                _ => String::new(),
            };
            let check = |end: usize, value: f64, low: f64| {
                let field = format!("randomize.{name}[{end}]");
                let why = |e: Error| match e {
                    Error::Invalid { field, reason } => Error::invalid(field, reason + &added),
                    other => other,
                };
                check_range(&field, value, low..=most).map_err(why)
            };
            check(0, low, least)?;
            check(1, high, low)?;
        }
        Ok(())
    }

    /// Draws an episode's quantities for a robot with `legs` legs and a commanded speed of `speed` [m/s]. The number
    /// and order of the draws are always the same.
    fn draw(
        &self,
        options: &TerrainOptions,
        speed: f64,
        legs: usize,
        random: &mut Random,
    ) -> (TerrainDraw, UsedGround) {
        let (difficulty, own) = (options.difficulty, &options.gait.walking);
        let ranges = self.quantities(own.slope_deg, own.payload).map(|TerrainQuantity { range, neutral, .. }| {
            range.map(|end| neutral.map_or(end, |neutral| neutral + difficulty * (end - neutral)))
        });
        let [zeta, patch_length, slope_deg, payload, torque_limit, footprint, turning_point] = ranges;
        let mut one = |[low, high]: [f64; 2]| random.uniform(low, high);
        let draw = TerrainDraw { slope_deg: one(slope_deg), payload: one(payload), torque_limit: one(torque_limit) };
        let ground = UsedGround {
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

/// The drawn quantities that are part of an episode's model.
struct TerrainDraw {
    slope_deg: f64,
    payload: f64,
    torque_limit: f64,
}

const ABOUT: &str = "\
This is HexapodGait on ground that the policy does not observe. Every reset draws the quantities in `randomize` from the episode's
random numbers; `info` has them at every step. They modify other options: `zeta` and `torque_limit` are factors, `slope_deg` and
`payload` are added.

**Media vary along x.** The bed is divided into patches of equal length, each with its own ζ; after 16 patches they repeat. All
legs use the sand of the patch under the base's centre, because the engine has one sand for each robot. The patch changes only
between control steps. By default patches are at least as long as the robot.

**Footprints.** A leg leaves a footprint at the point where its tip entered the sand, as soon as the tip leaves it. If a leg enters at the
distance d from the nearest footprint, its stress is 1 − κ e^(−d/3 cm) times that on fresh ground until it leaves the sand (mechanism
`footprint`; `info` has the mean over legs as `footing`). The last 512 footprints of all legs count. The belly leaves no footprints.
At the distance `turning_point` from the start, in the direction of the first command along x, the commanded speed changes its sign. It
changes again when the robot is back at the start. So the robot walks over its own footprints. If a robot slips in the other direction, the
command does not change. A clock cannot walk backward, so it needs a large `turning_point`.

**Curriculum.** `difficulty` from 0 to 1 scales the ranges of ζ, slope, payload, motors and κ from nothing to the whole of
`randomize`. A reset may change both options. See HexapodGait-v1 for `control`, the end of episodes and the cost of transport.";

/// The ground's part of an info row.
struct Drawn<'a> {
    t: &'a Transition<'a>,
    difficulty: f64,
    ground: &'a UsedGround,
}

/// Computes one number of this part.
type Figure = fn(&Drawn) -> f64;

/// The task; it calls HexapodGait for the parts that both share.
pub struct HexapodTerrain {
    gait: HexapodGait,
    spec: Spec,
    figures: Features<Figure>,
}

/// Info columns beyond HexapodGait's.
fn figures() -> Features<Figure> {
    Features::<Figure>::none()
        .free("difficulty", "1", |d| d.difficulty)
        .free("zeta", "1", |d| d.ground.zeta[d.ground.patch])
        .free("patch_length", "m", |d| d.ground.patch_length)
        .free("slope_deg", "°", |d| d.t.model.scene.slope_deg)
        .free("payload", "kg", |d| d.t.model.scene.payload)
        .free("torque_limit", "N·m", |d| d.t.model.motor.actuator.torque_limit.unwrap_or(f64::INFINITY))
        .free("footprint", "1", |d| d.ground.footprint)
        .free("turning_point", "m", |d| d.ground.turning_point)
        .free("footing", "1", |d| d.ground.footing.iter().sum::<f64>() / d.ground.footing.len() as f64)
}

/// The sand of the present patch.
fn sand(model: &Model, ground: &UsedGround) -> Medium {
    let own = &model.scene.medium;
    Medium { coefficients: own.coefficients.scaled(ground.zeta[ground.patch]), ..own.clone() }
}

impl Task for HexapodTerrain {
    const ID: &'static str = "sandgait/HexapodTerrain-v1";
    type Options = TerrainOptions;

    fn engine(options: &TerrainOptions) -> EngineKind {
        HexapodGait::engine(&options.gait)
    }

    fn drawn_bytes(setup: &Setup<TerrainOptions>) -> usize {
        setup.model.episode_bytes()
    }

    fn list_bytes(_setup: &Setup<TerrainOptions>) -> usize {
        UsedGround::LIST_BYTES
    }

    fn model(options: &TerrainOptions) -> Result<Model> {
        // Builds the model first, because its error message names slope or payload.
        let (model, own) = (HexapodGait::model(&options.gait)?, &options.gait.walking);
        options.randomize.validate(own.slope_deg, own.payload)?;
        if own.memory && options.randomize.footprint != [0.0; 2] {
            let reason = "memory and randomize.footprint describe the same thing: set randomize.footprint to [0, 0]";
            return Err(Error::invalid("memory", reason));
        }
        Ok(model)
    }

    fn new(setup: &Setup<TerrainOptions>) -> Result<Self> {
        let (gait, figures) = (HexapodGait::new(&setup.with(&setup.options.gait))?, figures());
        let mut spec = gait.spec().clone();
        spec.id = Self::ID;
        spec.about = ABOUT;
        spec.summary = spec.summary.replace("on sand", "over sand that varies and keeps footprints");
        spec.info.extend(figures.columns());
        Ok(Self { gait, spec, figures })
    }

    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup<TerrainOptions>, random: &mut Random) -> (State, TaskState) {
        let (state, task_state) = self.gait.begin(&setup.with(&setup.options.gait), random);
        let (options, legs) = (setup.options, setup.model.legs.len());
        let (draw, ground) = options.randomize.draw(options, task_state.speed, legs, random);
        let Scene { slope_deg, payload, .. } = setup.model.scene;
        let mut model = setup.model.with_medium(sand(setup.model, &ground));
        model.set_load(slope_deg + draw.slope_deg, payload + draw.payload);
        model.weaken_motors(draw.torque_limit);
        (state, TaskState { model: Some(Arc::new(model)), ground: Some(ground), ..task_state })
    }

    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        self.gait.command(action, state, command);
    }

    /// Updates footprints, patch and command.
    fn after_step(
        &self,
        setup: &Setup<TerrainOptions>,
        task_state: &mut TaskState,
        state: &State,
        _info: &[f32],
    ) -> Change {
        let (Some(ground), Some(model)) = (&mut task_state.ground, &mut task_state.model) else {
            return Change::Nothing;
        };
        let change = ground.after_step(model, state);
        if change == Change::Patch {
            *model = Arc::new(model.with_medium(sand(setup.model, ground)));
        }
        if ground.turned(state.position[0]) {
            task_state.speed = -task_state.speed;
        }
        change
    }

    fn command_ranges(&self, setup: &Setup<TerrainOptions>) -> Option<[[f64; 2]; 3]> {
        Some(setup.options.gait.walking.command_ranges())
    }

    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]) {
        self.gait.observe(task_state, state, last_action, row);
    }

    fn evaluate(&self, setup: &Setup<TerrainOptions>, t: &Transition, info: &mut [f32]) -> bool {
        let (walk, drawn) = info.split_at_mut(self.gait.spec().info.len());
        if let Some(ground) = &t.task_state.ground {
            let facts = Drawn { t, difficulty: setup.options.difficulty, ground };
            self.figures.fill(drawn, |value, _| value(&facts));
        }
        self.gait.evaluate(&setup.with(&setup.options.gait), t, walk)
    }

    fn resume(setup: &Setup<TerrainOptions>, task_state: &mut TaskState) -> std::result::Result<(), String> {
        let legs = setup.model.legs.len();
        match task_state {
            TaskState { ground: Some(ground), .. } if !ground.is_sound(legs) => Err("its ground".into()),
            TaskState { model: Some(_), ground: Some(_), legged: None, .. } => Ok(()),
            _ => Err("its robot, sand and ground".into()),
        }
    }
}
