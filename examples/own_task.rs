//! A task of your own in one file: `cargo run --release --example own_task`.
//!
//! `LevelWalk` rewards a hexapod for walking fast with a level base. Robot, sand, actions and observations are
//! those of HexapodGait.

use sandgait::Result;
use sandgait::env::feature::Features;
use sandgait::env::gait::{GaitOptions, HexapodGait};
use sandgait::env::random::Random;
use sandgait::env::registry::Blueprint;
use sandgait::env::task::{Setup, TaskState, Transition};
use sandgait::env::{Column, ResetOptions, Spec, Task, options, reward_terms};
use sandgait::pool::{Batch, Pool};
use sandgait::sim::engine::{Command, EngineKind};
use sandgait::sim::{Model, State};

options! {
    /// One line for each option: its type, default, bounds, help, and whether a reset can change it.
    pub struct LevelOptions {
        ..gait: GaitOptions = GaitOptions::default();
        largest_tilt: f64 = 0.8, [0.1, 3.0], reset, "tilt of the base that ends an episode [rad]";
        level_weights: LevelWeights = LevelWeights::default(), "weight of each reward term";
    }
}

reward_terms! {
    /// One line for each reward term: its default weight, description and function.
    pub struct LevelWeights of Transition<'_>, weights in [0.0, 100.0] {
        progress: 1.0, "speed uphill / 1 m/s", |t| (t.after.position[0] - t.before.position[0]) / t.period;
        level: 0.2, "cosine of the base's tilt, less 1", |t| t.after.rotation()[2][2] - 1.0;
    }
}

/// One line for each figure of `info`: its name, unit and function.
fn figures() -> Features<fn(&Transition) -> f64> {
    Features::<fn(&Transition) -> f64>::none()
        .free("tilt", "rad", |t| tilt(t.after))
        .free("work", "J", |t| t.after.work - t.before.work)
}

/// Angle between the base's z axis and the surface's normal [rad].
fn tilt(state: &State) -> f64 {
    state.rotation()[2][2].clamp(-1.0, 1.0).acos()
}

pub struct LevelWalk {
    gait: HexapodGait,
    spec: Spec,
    weights: LevelWeights,
    figures: Features<fn(&Transition) -> f64>,
}

impl Task for LevelWalk {
    const ID: &'static str = "example/LevelWalk-v0";
    type Options = LevelOptions;

    fn engine(options: &LevelOptions) -> EngineKind {
        HexapodGait::engine(&options.gait)
    }

    fn model(options: &LevelOptions) -> Result<Model> {
        HexapodGait::model(&options.gait)
    }

    fn new(setup: &Setup<LevelOptions>) -> Result<Self> {
        let (gait, weights, figures) =
            (HexapodGait::new(&setup.with(&setup.options.gait))?, setup.options.level_weights, figures());
        let reward = weights.terms();
        let info = [Column::rewards(&reward), figures.columns()].concat();
        let (summary, about) = ("Walk fast with a level base.".into(), "An episode ends beyond `largest_tilt`.");
        let spec = Spec { id: Self::ID, summary, about, reward, info, ..gait.spec().clone() };
        Ok(Self { gait, spec, weights, figures })
    }

    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn begin(&self, setup: &Setup<LevelOptions>, random: &mut Random) -> (State, TaskState) {
        self.gait.begin(&setup.with(&setup.options.gait), random)
    }

    fn command(&self, action: &[f32], state: &State, command: &mut Command) {
        self.gait.command(action, state, command);
    }

    fn observe(&self, task_state: &TaskState, state: &State, last_action: &[f32], row: &mut [f32]) {
        self.gait.observe(task_state, state, last_action, row);
    }

    fn evaluate(&self, setup: &Setup<LevelOptions>, t: &Transition, info: &mut [f32]) -> bool {
        let (rewards, rest) = info.split_at_mut(self.spec.reward.len());
        self.weights.fill(t, 1.0, rewards);
        self.figures.fill(rest, |value, _| value(t));
        !t.diverged && tilt(t.after) > setup.options.largest_tilt
    }
}

/// Mean return of 16 robots whose hips turn at half speed for 2 s.
pub fn played(keywords: serde_json::Value) -> Result<f64> {
    let (blueprint, pool) = (Blueprint::of::<LevelWalk>(keywords)?, Pool::new(1));
    let mut batch = Batch::new(&blueprint, 16)?;
    let operation = batch.reset(None, Some((0..16).collect()), ResetOptions::default())?;
    batch = pool.wait(batch, operation)?;
    let mut sum = 0.0;
    for _ in 0..100 {
        let operation = batch.step(vec![0.5; 16 * batch.spec().action.len()])?;
        batch = pool.wait(batch, operation)?;
        sum += batch.shards().iter().flat_map(|shard| &shard.rows.rewards).sum::<f32>() / 16.0;
    }
    Ok(sum.into())
}

fn main() -> Result<()> {
    println!("return {:.2}", played(serde_json::json!({"medium": "poppy-close", "level_weights": {"level": 1.0}}))?);
    Ok(())
}
