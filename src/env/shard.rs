//! Environments that advance together: one engine, one task, flat rows allocated once.

use super::episode::{Before, Ended, Environment, Episode};
use super::ground::Change;
use super::random::Random;
use super::registry::Blueprint;
use super::rollout::{Recorded, Rollout};
use super::sensors::{ActionDelay, SensorModel};
use super::spec::Spec;
use super::task::{AnyTask, Transition};
use super::unfinished::UnfinishedStep;
use crate::error::Result;
use crate::sim::engine::{Command, Engine};
use crate::sim::{Model, State};
use std::sync::Arc;
use std::time::Duration;

pub use super::rows::Rows;

/// Consecutive environments of one session. One thread owns a shard at a time.
pub struct Shard {
    task: Arc<dyn AnyTask>,
    pub(super) engine: Engine,
    pub(super) environments: Vec<Environment>,
    pub(super) command: Command,
    pub(super) substeps: usize,
    period: f64,
    pub rows: Rows,
    pub rollout: Rollout,
    /// The control step that is not finished yet.
    pub(super) unfinished: Option<UnfinishedStep>,
    /// Copies of the environments before the present operation, if it can be undone.
    pub(super) kept: Vec<Option<Episode>>,
}

impl Shard {
    /// `envs` environments without a state; [`Shard::reset`] must come first.
    pub fn new(blueprint: &Blueprint, envs: usize) -> Result<Self> {
        let spec = blueprint.task.spec();
        let model = blueprint.task.model();
        let period = 1.0 / spec.control_rate;
        Ok(Self {
            task: blueprint.task.clone(),
            engine: Engine::new(blueprint.engine, model, envs)?,
            environments: (0..envs).map(|_| Environment::new(blueprint.task.clone())).collect(),
            command: Command::still(model.joints()),
            substeps: (period / model.scene.dt).round() as usize,
            period,
            rows: Rows::new(envs, spec.observation.len(), spec.info.len()),
            rollout: Rollout::default(),
            unfinished: None,
            kept: Vec::new(),
        })
    }

    pub fn envs(&self) -> usize {
        self.environments.len()
    }

    pub(super) fn spec(&self) -> &Spec {
        self.task.spec()
    }

    /// Numbers in an action row.
    pub fn actions(&self) -> usize {
        self.task.spec().action.len()
    }

    /// Present state of environment `i`; right after the end of an episode, this is the start of the next episode.
    pub fn state(&self, i: usize) -> &State {
        &self.environments[i].episode.state
    }

    /// The model that simulates environment `i`'s episode.
    pub fn model(&self, i: usize) -> &Model {
        self.environments[i].episode.model()
    }

    /// Are the present episodes all at their first step?
    pub fn is_fresh(&self) -> bool {
        self.environments.iter().all(|e| e.episode.steps == 0)
    }

    /// Begins new episodes in the environments for which `chosen` is true. An environment for which `task` has an entry
    /// gets this task instead of its own. With `seeds`, the streams of random numbers start anew; without, they
    /// continue.
    pub fn reset<'a>(
        &mut self,
        chosen: impl Fn(usize) -> bool,
        seeds: Option<&[u64]>,
        task: impl Fn(usize) -> Option<&'a Arc<dyn AnyTask>>,
    ) {
        self.rows.clear();
        for i in (0..self.environments.len()).filter(|i| chosen(*i)) {
            let Environment { episode, stale, ended, .. } = &mut self.environments[i];
            *ended = None;
            if let Some(task) = task(i) {
                *stale = true;
                episode.task = task.clone();
            }
            match seeds {
                Some(seeds) => (episode.seed, episode.number) = (seeds[i], 0),
                None => episode.number += 1,
            }
            self.begin(i, Before::Begin);
        }
    }

    /// Replaces the command of environment `i` for the rest of its episode: forward, to the left [m/s], yaw [rad/s]. See
    /// [`AnyTask::check_command`].
    pub fn set_command(&mut self, i: usize, command: [f64; 3]) {
        let environment = &mut self.environments[i];
        environment.episode.task.set_command(&mut environment.episode.task_state, command);
        let wide = self.task.spec().observation.len();
        // Sensors take a sample in each step, so a policy that observes through sensors sees the command one step
        // later.
        let row = &mut self.rows.observations[i * wide..][..wide];
        environment.observe(Before::Restore, self.period, self.engine.sand(i), row, &mut []);
    }

    /// Evaluates environment `i`'s step, and begins the next episode if the present one has ended.
    pub(super) fn finish(&mut self, i: usize, action: &[f32]) {
        let spec = self.task.spec();
        let (wide, info) = (spec.observation.len(), spec.info.len());
        let Environment { episode, before, normal_forces, foot_loads, .. } = &mut self.environments[i];
        self.engine.state(i, &mut episode.state);
        self.engine.foot_loads(i, foot_loads);
        if episode.task.sensing().is_some_and(SensorModel::needs_normal_forces) {
            self.engine.normal_forces(i, normal_forces);
        }
        let diverged = !episode.state.is_sound();
        if diverged {
            episode.state.clone_from(before);
        }
        episode.steps += 1;
        let row = &mut self.rows.infos[i * info..][..info];
        let terminated = episode.task.evaluate(
            &Transition {
                model: episode.model(),
                task_state: &episode.task_state,
                before,
                after: &episode.state,
                foot_loads,
                action,
                previous_action: &episode.last_action,
                period: self.period,
                diverged,
            },
            row,
        );
        let truncated = diverged || (!terminated && episode.steps >= spec.max_episode_steps);
        episode.last_action.copy_from_slice(action);
        self.rows.rewards[i] = row[..spec.reward.len()].iter().sum();
        self.rows.terminated[i] = u8::from(terminated);
        self.rows.truncated[i] = u8::from(truncated);
        let change = episode.task.after_step(&mut episode.task_state, &episode.state, row);
        if let Change::Push([x, y]) = change {
            (episode.state.velocity[0], episode.state.velocity[1]) = (x, y);
            put_back(&mut self.engine, i, &mut episode.state);
            self.engine.state(i, &mut episode.state);
        } else if change != Change::Nothing {
            change_ground(&mut self.engine, i, episode, change);
        }
        self.observe(i, Before::Step);
        if terminated || truncated {
            let Environment { episode, before, ended, .. } = &mut self.environments[i];
            self.rows.ended.push(i as u32);
            self.rows.final_observations.extend_from_slice(&self.rows.observations[i * wide..][..wide]);
            episode.number += 1;
            let action = episode.last_action.clone();
            *ended = Some(Ended { task_state: episode.task_state.clone(), steps: episode.steps, action });
            std::mem::swap(before, &mut episode.state);
            self.begin(i, Before::End);
        }
    }

    /// Starts environment `i`'s episode with its present number, and fills its observation row.
    fn begin(&mut self, i: usize, before: Before) {
        let Environment { episode, stale, begun, .. } = &mut self.environments[i];
        *begun = true;
        let mut random = Random::new(episode.seed, episode.number);
        // A new seed begins a new series of episodes.
        let last = (episode.number > 0).then_some(&episode.task_state);
        (episode.state, episode.task_state) = episode.task.begin(last, &mut random);
        episode.task.draw_motors(&mut episode.task_state, episode.seed, episode.number);
        episode.steps = 0;
        episode.last_action.fill(0.0);
        let (range, clock) = (episode.task.action_delay(), [self.period, self.period / self.substeps as f64]);
        let width = episode.last_action.len();
        episode.delay = ActionDelay::draw(range, [episode.seed, episode.number], width, clock);
        let stale = std::mem::take(stale);
        match &episode.task_state.model {
            Some(model) => self.engine.set_model(i, model),
            None if stale => self.engine.set_model(i, episode.task.model()),
            None => (),
        }
        self.take_up(i, before);
    }

    /// Gives environment `i`'s state to the engine and fills its observation row and the sensors' part of its info row.
    pub(super) fn take_up(&mut self, i: usize, before: Before) {
        let episode = &mut self.environments[i].episode;
        self.engine.set_state(i, &episode.state);
        // From here on, the sand is in the engine.
        episode.state.sand = None;
        if episode.task_state.ground.is_some() {
            change_ground(&mut self.engine, i, episode, Change::Footing);
        }
        self.engine.state(i, &mut episode.state);
        self.observe(i, before);
    }

    /// Fills environment `i`'s observation row, and the sensors' part of its info row.
    fn observe(&mut self, i: usize, before: Before) {
        let spec = self.task.spec();
        let (wide, info) = (spec.observation.len(), spec.info.len());
        let row = &mut self.rows.observations[i * wide..][..wide];
        let infos = &mut self.rows.infos[i * info..][..info];
        self.environments[i].observe(before, self.period, self.engine.sand(i), row, infos);
    }
}

impl Shard {
    /// Prepares a rollout; must be called before the first [`Shard::roll`].
    pub fn begin_rollout(&mut self) {
        self.rollout = Rollout::begin(self.envs());
    }

    /// Goes on with the next step of a rollout for about `time`; returns whether the step is done. `actions` is f32
    /// [envs, action] within its bounds, the same until the step is done.
    pub fn roll_part(&mut self, actions: &[f32], record: bool, time: Duration) -> bool {
        if !self.step_part(actions, |_| false, time) {
            return false;
        }
        let over: Vec<bool> = (0..self.envs()).map(|i| self.rollout.is_over(i)).collect();
        let (rows, rollout) = (&self.rows, &mut self.rollout);
        for i in (0..over.len()).filter(|i| !over[*i]) {
            rollout.returns[i] += f64::from(rows.rewards[i]);
            rollout.lengths[i] += 1;
            rollout.terminated[i] = rows.terminated[i];
            rollout.truncated[i] = rows.truncated[i];
        }
        if record {
            let step = self.recorded(actions, &over);
            self.rollout.steps.push(step);
        }
        true
    }

    /// Continues a rollout by one step; `actions` is f32 [envs, action] within its bounds.
    pub fn roll(&mut self, actions: &[f32], record: bool) {
        self.roll_part(actions, record, Duration::MAX);
    }

    /// The last step's rows, with zeros for environments that are `over`.
    fn recorded(&self, actions: &[f32], over: &[bool]) -> Recorded {
        let rows = &self.rows;
        let [wide, width] = [rows.observations.len(), actions.len()].map(|n| n / over.len());
        let (observations, rewards) = (rows.observations.clone(), rows.rewards.clone());
        let mut step = Recorded { observations, rewards, actions: actions.to_vec() };
        for (i, last) in rows.ended.iter().zip(rows.final_observations.chunks_exact(wide)) {
            step.observations[*i as usize * wide..][..wide].copy_from_slice(last);
        }
        for i in (0..over.len()).filter(|i| over[*i]) {
            step.observations[i * wide..][..wide].fill(0.0);
            step.actions[i * width..][..width].fill(0.0);
            step.rewards[i] = 0.0;
        }
        step
    }
}

/// Sets the state of environment `i`, which stays in the sand that it has moved.
fn put_back(engine: &mut Engine, i: usize, state: &mut State) {
    state.sand = engine.sand(i).cloned().map(Box::new);
    engine.set_state(i, state);
    state.sand = None;
}

/// Gives the engine the changes of environment `i`'s ground.
fn change_ground(engine: &mut Engine, i: usize, episode: &mut Episode, change: Change) {
    let (Some(ground), Some(model)) = (&episode.task_state.ground, &episode.task_state.model) else { return };
    if change == Change::Patch {
        engine.set_model(i, model);
        put_back(engine, i, &mut episode.state);
    }
    engine.set_footing(i, model, &ground.footing);
}
