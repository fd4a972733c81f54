//! `sandgait/HexapodRocks-v1`: HexapodGait among rocks and steps that are drawn anew for every episode.

use super::gait::{GaitOptions, HexapodGait};
use super::locomotion;
use super::random::Random;
use super::spec::{Column, Spec};
use super::task::{Setup, Task, TaskState, Transition};
use super::walking::Walking;
use crate::error::{Error, Result, check_range};
use crate::options;
use crate::options::NumberPair;
use crate::sim::engine::{Command, EngineKind};
use crate::sim::obstacle::{FRICTION, Obstacle, ObstacleShape};
use crate::sim::overlap::obstacle_poses;
use crate::sim::solid::Solid;
use crate::sim::{Model, State};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::sync::Arc;

options! {
    /// Options of HexapodRocks.
    pub struct RocksOptions {
        ..gait: GaitOptions = GaitOptions {
            walking: Walking {
                engine: EngineKind::Rapier,
                dt: EngineKind::Rapier.default_dt(),
                ..Walking::default()
            },
            ..GaitOptions::default()
        };
        rocks: RockOptions = RockOptions::default(), reset, "obstacles on the sand";
    }
}

options! {
    /// The obstacles on the sand. Sizes are our choice: rocks of half to one and a half times the reference robot's
    /// leg, steps of up to half a leg. Sixteen obstacles on the default field are some two body lengths apart. Granite
    /// has 2,650 kg/m³.
    #[derive(Copy, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct RockOptions {
        count: usize = 16, [0.0, 64.0], reset, "number of obstacles of an episode; fewer if there is not enough free space";
        size: [f64; 2] = [0.02, 0.06], [5e-3, 0.5], reset, "range [low, high] of a rock's diameter and a step's length and width [m]";
        step_height: [f64; 2] = [0.0, 0.02], [0.0, 0.5], reset, "range [low, high] of a step's height over the sand [m]";
        dynamic_fraction: f64 = 0.5, [0.0, 1.0], reset, "share of loose rocks; half of the other obstacles are fixed rocks and half are steps";
        density: f64 = 2650.0, [100.0, 2e4], reset, "density of loose rocks [kg/m³]";
        friction: f64 = FRICTION, [0.0, 10.0], reset, "Coulomb friction coefficient between robot and rock";
        field: NumberPair = NumberPair([1.6, 0.8]), reset, "length and width of the field of obstacles [m]; the robot starts on its centre line, 0.3 m from its beginning";
    }
}

/// Distance behind the start at which the field begins [m]: our choice, two lengths of the reference robot.
const BEHIND: f64 = 0.3;

/// No obstacle is closer to the start than this [m]: our choice, half the reference robot's length, a leg and a margin.
const CLEAR: f64 = 0.15;

/// Largest number of random positions tried for one obstacle before it is left out. Our choice, because more
/// than half of the default field is free.
const TRIES: usize = 20;

/// Corners of a rock: our choice, enough to look irregular.
pub(super) const CORNERS: usize = 12;

/// Height scan: coordinates of its points ahead of the base's centre and to the sides [m], relative to the heading.
/// Our choice: from under the base to 12.5 cm, less than a body length, ahead of it.
const SCAN_X: [f64; 7] = [-0.05, 0.0, 0.05, 0.1, 0.13, 0.16, 0.2];
const SCAN_Y: [f64; 5] = [-0.1, -0.05, 0.0, 0.05, 0.1];

/// Bound of a scanned height [m]; larger values are clipped. Our choice, above the 6 cm of the highest default rock.
const SCAN_HEIGHT: f64 = 0.1;

impl RockOptions {
    /// Our choice of the smallest field: it contains the circle of [`CLEAR`] around the start.
    fn validate(&self) -> Result<()> {
        check_range("rocks.field[0]", self.field.0[0], 0.5..=100.0)?;
        check_range("rocks.field[1]", self.field.0[1], 0.4..=100.0).map(drop)
    }

    /// Draws an episode's obstacles; none overlap at the start.
    pub fn draw(&self, random: &mut Random) -> Vec<Obstacle> {
        let mut placed: Vec<([f64; 2], f64)> = vec![([0.0; 2], CLEAR)];
        let mut obstacles = Vec::with_capacity(self.count);
        for _ in 0..self.count {
            let (obstacle, reach) = self.obstacle(random);
            let place = (0..TRIES).map(|_| self.place(random)).collect::<Vec<_>>();
            let free = |at: &[f64; 2]| placed.iter().all(|(p, r)| (p[0] - at[0]).hypot(p[1] - at[1]) > r + reach);
            let Some(at) = place.into_iter().find(free) else { continue };
            placed.push((at, reach));
            obstacles.push(Obstacle { position: [at[0], at[1], obstacle.position[2]], ..obstacle });
        }
        obstacles
    }

    fn place(&self, random: &mut Random) -> [f64; 2] {
        let NumberPair([length, width]) = self.field;
        [random.uniform(-BEHIND, length - BEHIND), random.uniform(-width / 2.0, width / 2.0)]
    }

    /// One obstacle at the origin, and the radius [m] of the free space that it needs: for a rock, our choice, half a
    /// radius more than its own.
    fn obstacle(&self, random: &mut Random) -> (Obstacle, f64) {
        let size = |random: &mut Random| random.uniform(self.size[0], self.size[1]);
        let (loose, step) = (random.uniform(0.0, 1.0) < self.dynamic_fraction, random.uniform(0.0, 1.0) < 0.5);
        let (yaw, height) = (random.uniform(0.0, TAU), random.uniform(self.step_height[0], self.step_height[1]));
        if step && !loose {
            let (length, width) = (size(random), size(random));
            let block = Obstacle::block([0.0; 2], [length, width], height, yaw);
            return (Obstacle { friction: self.friction, ..block }, length.hypot(width) / 2.0);
        }
        let radius = size(random) / 2.0;
        // Loose rocks lie on the sand; fixed ones are buried by up to half.
        let up = if loose { radius } else { radius * random.uniform(0.0, 1.0) };
        let rock = Obstacle::fixed(rock(radius, random), [0.0, 0.0, up]).turned(yaw);
        let rock = Obstacle { friction: self.friction, ..rock };
        (if loose { rock.loose(self.density) } else { rock }, 1.5 * radius)
    }
}

/// An irregular rock: hull of points on an ellipsoid with half axes of 0.7 to 1 times `radius` [m], our choice. Three
/// pairs of the points lie on the ellipsoid's axes, so the hull has a volume.
fn rock(radius: f64, random: &mut Random) -> ObstacleShape {
    let axes = [0; 3].map(|_| radius * random.uniform(0.7, 1.0));
    let mut points = Vec::with_capacity(CORNERS);
    for (axis, length) in axes.into_iter().enumerate() {
        let mut point = [0.0; 3];
        point[axis] = length;
        points.extend([point, point.map(|c: f64| -c)]);
    }
    while points.len() < CORNERS {
        let (z, turn) = (random.uniform(-1.0, 1.0), random.uniform(0.0, TAU));
        let across = (1.0 - z * z).sqrt();
        points.push([axes[0] * across * turn.cos(), axes[1] * across * turn.sin(), axes[2] * z]);
    }
    ObstacleShape::Hull { points }
}

const ABOUT: &str = "\
This is HexapodGait on a field of obstacles that is drawn for every episode: fixed rocks, steps, and loose rocks that the robot can
push. The last numbers of the observation are heights around the base. rapier computes the rigid contacts. See HexapodGait-v1
for `control`, the end of episodes and the cost of transport.";

/// The task; it calls HexapodGait for the parts that both share.
pub struct HexapodRocks {
    gait: HexapodGait,
    spec: Spec,
}

/// The scan's points in the order of the columns [m].
fn scan_points() -> impl Iterator<Item = [f64; 2]> {
    SCAN_X.into_iter().flat_map(|x| SCAN_Y.into_iter().map(move |y| [x, y]))
}

/// Heights of obstacles above the sand [m] at the scan's points, 0 where there is only sand.
fn scan(model: &Model, state: &State, row: &mut [f32]) {
    let [cos, sin] = locomotion::heading(state);
    let poses = obstacle_poses(model, state);
    let reach = SCAN_X[SCAN_X.len() - 1].hypot(SCAN_Y[0]);
    let near: Vec<(&Solid, _)> = model
        .solids
        .iter()
        .zip(&poses)
        .filter(|(s, p)| {
            let away = (p.position.x - state.position[0]).hypot(p.position.y - state.position[1]);
            away < reach + s.reach()
        })
        .collect();
    for (out, [x, y]) in row.iter_mut().zip(scan_points()) {
        let at = [state.position[0] + cos * x - sin * y, state.position[1] + sin * x + cos * y];
        let tops = near.iter().filter_map(|(solid, pose)| solid.top(pose, at[0], at[1]));
        *out = tops.fold(0.0, f64::max) as f32;
    }
}

impl Task for HexapodRocks {
    const ID: &'static str = "sandgait/HexapodRocks-v1";
    type Options = RocksOptions;

    fn engine(options: &RocksOptions) -> EngineKind {
        HexapodGait::engine(&options.gait)
    }

    fn model(options: &RocksOptions) -> Result<Model> {
        options.rocks.validate()?;
        let engine = Self::engine(options);
        if engine != EngineKind::Rapier {
            let reason = format!("{} has no rigid obstacles; this task needs rapier", engine.name());
            return Err(Error::invalid("engine", reason));
        }
        HexapodGait::model(&options.gait)
    }

    fn new(setup: &Setup<RocksOptions>) -> Result<Self> {
        let gait = HexapodGait::new(&setup.with(&setup.options.gait))?;
        let mut spec = gait.spec().clone();
        spec.id = Self::ID;
        spec.about = ABOUT;
        spec.summary = spec.summary.replace("on sand", "among rocks and steps");
        let scan = scan_points().map(|[x, y]| {
            let name =
                format!("height of what lies {} cm ahead and {} cm to the left", (x * 1e2) as i32, (y * 1e2) as i32);
            Column::new(name, "m", 0.0, SCAN_HEIGHT)
        });
        spec.observation.extend(scan);
        Ok(Self { gait, spec })
    }

    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup<RocksOptions>, random: &mut Random) -> (State, TaskState) {
        let (mut state, task_state) = self.gait.begin(&setup.with(&setup.options.gait), random);
        let rocks = setup.options.rocks.draw(random);
        // Obstacles from `draw` are within every range, which a test checks.
        let model = setup.model.with_obstacles(&rocks).map_or_else(|_| setup.model.clone(), Arc::new);
        state.objects = model.objects_at_rest();
        (state, TaskState { model: Some(model), ..task_state })
    }

    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        self.gait.command(action, state, command);
    }

    fn command_ranges(&self, setup: &Setup<RocksOptions>) -> Option<[[f64; 2]; 3]> {
        Some(setup.options.gait.walking.command_ranges())
    }

    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]) {
        let (gait, heights) = row.split_at_mut(self.gait.spec().observation.len());
        self.gait.observe(task_state, state, last_action, gait);
        if let Some(model) = &task_state.model {
            scan(model, state, heights);
        }
    }

    fn evaluate(&self, setup: &Setup<RocksOptions>, transition: &Transition, info: &mut [f32]) -> bool {
        self.gait.evaluate(&setup.with(&setup.options.gait), transition, info)
    }

    fn drawn_bytes(setup: &Setup<RocksOptions>) -> usize {
        // A random rock has more corners and sides than a step.
        let rock = Obstacle::fixed(rock(RockOptions::default().size[1], &mut Random::new(0, 0)), [0.0; 3]);
        // Its numbers are within every range, which a test checks.
        setup.model.episode_bytes() + setup.options.rocks.count * rock.memory_bytes().unwrap_or_default()
    }

    fn most_obstacles(options: &RocksOptions) -> usize {
        options.rocks.count
    }

    fn resume(_setup: &Setup<RocksOptions>, task_state: &mut TaskState) -> std::result::Result<(), String> {
        match task_state {
            TaskState { model: Some(_), ground: None, legged: None, .. } => Ok(()),
            _ => Err("its rocks".into()),
        }
    }
}
