//! Rollouts: environments play some steps with the present policy, and the transitions are stored.

use super::learn::RolloutBuffer;
use super::loss::ActionNoise;
use super::network::{NetworkPass, Networks};
use super::normal::{BatchMoments, NormalizerScales};
use super::remote::of_part;
use super::settings::Hyperparameters;
use super::spec::TrainingSpec;
use super::teacher::Teacher;
use crate::env::Shard;
use crate::env::episode::Episode;
use crate::env::shard::Rows;
use crate::env::snapshot::SavedEpisode;
use crate::error::Result;
use rand::{Rng as _, SeedableRng as _};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::ops::DerefMut;

/// Number of pieces into which the environments are divided, the same for any number of threads; fewer for engines with
/// lanes. Our choice: at most so many threads act at a time, and smaller pieces make smaller batches for the networks.
const PIECES: usize = 8;

/// Name of the info column with the level of a curriculum.
const LEVEL: &str = "level";

/// The environments of a group.
enum GroupEnvironments {
    Here(Box<Shard>),
    /// Remote environments, which are on a server or in another program. This holds only the rows of their last reset
    /// or step.
    Away(Rows),
}

impl GroupEnvironments {
    /// The rows of the last reset or step.
    fn rows(&self) -> &Rows {
        match self {
            Self::Here(shard) => &shard.rows,
            Self::Away(rows) => rows,
        }
    }
}

/// Some of the environments, and their transitions in this rollout; rows of a step are contiguous.
pub struct RolloutGroup {
    place: GroupEnvironments,
    /// Number of environments.
    pub envs: usize,
    /// Does the teacher act in this rollout?
    imitates: bool,
    random: Xoshiro256PlusPlus,
    pass: NetworkPass,
    spread: ActionNoise,
    /// f32 [envs, action], clipped to the action space.
    pub clipped: Vec<f32>,
    /// Bounds of each number of an action.
    bounds: Vec<[f32; 2]>,
    pub data: RolloutBuffer,
    /// Did the episode end with this step?
    ended: Vec<bool>,
    /// Rows of this rollout that are not transitions, because the step began the next episode.
    pub skipped: Vec<usize>,
    /// Discounted sum of rewards of each environment, for their normalization.
    pub discounted: Vec<f64>,
    /// Statistics of the observations and the discounted sums in the last step.
    pub seen: [BatchMoments; 2],
    /// Sums of the weighted reward terms in this rollout, and the levels of the environments at its end.
    pub terms: Vec<f64>,
    pub levels: Vec<f32>,
    /// Info column with the level of a curriculum.
    level: Option<usize>,
    /// Sums of rewards: for each environment those of its present episode so far, and one sum for each episode that
    /// ended in this rollout.
    pub running: Vec<f64>,
    pub finished: Vec<f64>,
}

/// Data that all pieces share while they play.
#[derive(Clone, Copy)]
pub struct PolicyContext<'a> {
    pub settings: &'a Hyperparameters,
    pub networks: &'a Networks,
    pub teacher: Option<&'a Teacher>,
    pub parameters: &'a [f32],
    pub scales: Option<&'a NormalizerScales>,
}

impl RolloutGroup {
    /// All environments of a training, without a state yet; `away`: they are remote.
    pub fn all(spec: &TrainingSpec, settings: &Hyperparameters, networks: &Networks, away: bool) -> Result<Vec<Self>> {
        let lanes = spec.blueprint.as_ref().map_or(1, |blueprint| blueprint.engine.shard_size());
        let size = settings.n_envs.div_ceil(PIECES).next_multiple_of(lanes);
        let starts = (0..settings.n_envs).step_by(size);
        let piece = |start: usize| {
            let envs = size.min(settings.n_envs - start);
            let place = match away {
                true => GroupEnvironments::Away(Rows::default()),
                false => GroupEnvironments::Here(Box::new(Shard::new(spec.task()?, envs)?)),
            };
            Ok(Self::new(spec, envs, settings, networks, place))
        };
        starts.map(piece).collect()
    }

    fn new(
        spec: &TrainingSpec,
        envs: usize,
        settings: &Hyperparameters,
        networks: &Networks,
        place: GroupEnvironments,
    ) -> Self {
        let [wide, width] = [networks.shape.observation, networks.shape.action];
        let task = spec.blueprint.as_ref().map(|blueprint| blueprint.task.spec());
        Self {
            place,
            envs,
            imitates: false,
            random: Xoshiro256PlusPlus::seed_from_u64(0),
            pass: networks.pass(envs),
            spread: ActionNoise::default(),
            clipped: vec![0.0; envs * width],
            bounds: spec.action_bounds(),
            data: RolloutBuffer::new(envs * settings.n_steps, wide, width),
            ended: vec![false; envs * settings.n_steps],
            skipped: Vec::new(),
            discounted: vec![0.0; envs],
            seen: [BatchMoments::new(wide), BatchMoments::new(1)],
            terms: vec![0.0; task.map_or(0, |spec| spec.reward.len())],
            levels: Vec::new(),
            level: task.and_then(|spec| spec.info.iter().position(|column| column.name == LEVEL)),
            running: vec![0.0; envs],
            finished: Vec::new(),
        }
    }

    /// Begins the first episodes of environments in this process.
    pub fn reset(&mut self, seeds: &[u64]) {
        if let GroupEnvironments::Here(shard) = &mut self.place {
            shard.reset(|_| true, Some(seeds), |_| None);
            self.seen[0].set(&shard.rows.observations);
        }
    }

    /// Takes `rows`, the first rows of remote environments.
    pub fn take(&mut self, rows: Rows) {
        self.seen[0].set(&rows.observations);
        self.place = GroupEnvironments::Away(rows);
    }

    /// The present episodes; none if the environments are remote.
    pub fn episodes(&self) -> Vec<SavedEpisode> {
        match &self.place {
            GroupEnvironments::Here(shard) => (0..self.envs).map(|i| shard.save(i)).collect(),
            GroupEnvironments::Away(_) => Vec::new(),
        }
    }

    /// Continues these episodes, one in each environment.
    pub fn resume(&mut self, episodes: &[Episode]) {
        if let GroupEnvironments::Here(shard) = &mut self.place {
            shard.rows.clear();
            episodes.iter().enumerate().for_each(|(i, episode)| shard.restore(i, episode));
        }
    }

    /// Prepares a rollout; its noise is a function of `seed`. `imitates`: does the teacher act?
    pub fn begin(&mut self, seed: u64, imitates: bool) {
        self.imitates = imitates;
        self.random = Xoshiro256PlusPlus::seed_from_u64(seed);
        self.finished.clear();
        self.skipped.clear();
        self.terms.fill(0.0);
    }

    /// Makes step `step` of the rollout; if the environments are remote, it only computes the actions.
    pub fn act(&mut self, play: &PolicyContext, step: usize) {
        if step > 0 {
            self.pay(play, step - 1);
        }
        let shape = &play.networks.shape;
        let (wide, width) = (shape.observation, shape.action);
        let rows = step * self.envs..(step + 1) * self.envs;
        let observations = &mut self.data.observations[rows.start * wide..rows.end * wide];
        observe(play, &self.place.rows().observations, observations);
        play.networks.forward(play.parameters, &mut self.pass, self.envs, |out| out.copy_from_slice(observations));
        if let Some(teacher) = play.teacher.filter(|_| self.imitates) {
            let rows = self.place.rows().observations.chunks_exact(wide);
            rows.zip(self.pass.means.chunks_exact_mut(width)).for_each(|(row, mean)| teacher.act(row, mean));
        }
        self.spread.set(&play.parameters[shape.log_std.clone()]);
        let deviations = &play.parameters[shape.log_std.clone()];
        let actions = &mut self.data.actions[rows.start * width..rows.end * width];
        let all = actions.chunks_exact_mut(width).zip(self.pass.means.chunks_exact(width));
        for ((action, mean), clipped) in all.zip(self.clipped.chunks_exact_mut(width)) {
            for (k, action) in action.iter_mut().enumerate() {
                let noise: f32 = self.random.sample(StandardNormal);
                *action = mean[k] + deviations[k].exp() * noise;
                let [low, high] = self.bounds[k];
                // Not `clamp`, because NaN must not reach the simulation.
                clipped[k] = action.max(low).min(high);
            }
        }
        for (k, row) in rows.clone().enumerate() {
            let part = k * width..(k + 1) * width;
            let (action, mean) = (&actions[part.clone()], &self.pass.means[part]);
            self.data.log_probabilities[row] = self.spread.log_probability(action, mean);
        }
        if self.imitates {
            self.data.actions[rows.start * width..rows.end * width]
                .copy_from_slice(&self.pass.means[..self.envs * width]);
        }
        self.data.values[rows.clone()].copy_from_slice(&self.pass.values[..self.envs]);
        if let GroupEnvironments::Here(shard) = &mut self.place {
            shard.step(&self.clipped);
            self.note(play, step, &[]);
        }
    }

    /// Stores `rows`, the results of step `step` of remote environments. An environment whose `skipped` is true did not
    /// make this step.
    pub fn answered(&mut self, play: &PolicyContext, step: usize, rows: Rows, skipped: &[bool]) {
        self.place = GroupEnvironments::Away(rows);
        self.note(play, step, skipped);
    }

    /// Stores the results of step `step`.
    fn note(&mut self, play: &PolicyContext, step: usize, skipped: &[bool]) {
        let rows = self.place.rows();
        let infos = rows.infos.chunks_exact((rows.infos.len() / self.envs).max(1));
        for row in infos.clone() {
            self.terms.iter_mut().zip(row).for_each(|(sum, term)| *sum += f64::from(*term));
        }
        self.levels.clear();
        self.levels.extend(self.level.iter().flat_map(|k| infos.clone().map(|row| row[*k])));
        let is_skipped = |i: &usize| skipped.get(*i) == Some(&true);
        for (i, row) in (step * self.envs..(step + 1) * self.envs).enumerate() {
            if is_skipped(&i) {
                self.skipped.push(row);
                (self.data.rewards[row], self.ended[row]) = (0.0, false);
                continue;
            }
            let reward = f64::from(rows.rewards[i]);
            let ended = rows.terminated[i] + rows.truncated[i] > 0;
            self.data.rewards[row] = rows.rewards[i];
            self.ended[row] = ended;
            self.discounted[i] = self.discounted[i] * play.settings.gamma + reward;
            self.running[i] += reward;
            if ended {
                self.finished.push(std::mem::take(&mut self.running[i]));
            }
        }
        if play.scales.is_some() {
            self.seen[0].set(&rows.observations);
            let made = (0..self.envs).filter(|i| !is_skipped(i)).map(|i| self.discounted[i]);
            self.seen[1].set(&made.collect::<Vec<_>>());
        }
        for i in &rows.ended {
            self.discounted[*i as usize] = 0.0;
        }
    }

    /// Normalizes the rewards of step `step`, the last step that was made. If an episode was truncated, adds the
    /// discounted value of its last observation.
    fn pay(&mut self, play: &PolicyContext, step: usize) {
        let first = step * self.envs;
        if let Some(scales) = play.scales {
            scales.rewards(&mut self.data.rewards[first..first + self.envs]);
        }
        let rows = self.place.rows();
        if rows.ended.is_empty() {
            return;
        }
        play.networks.forward(play.parameters, &mut self.pass, rows.ended.len(), |out| {
            observe(play, &rows.final_observations, out);
        });
        for (i, value) in rows.ended.iter().zip(&self.pass.values) {
            let i = *i as usize;
            if rows.truncated[i] > 0 && rows.terminated[i] == 0 {
                self.data.rewards[first + i] += play.settings.gamma as f32 * value;
            }
        }
    }

    /// After the last step: computes advantages by generalized advantage estimation (Schulman et al. 2016,
    /// arXiv:1506.02438).
    pub fn finish(&mut self, play: &PolicyContext) {
        let (envs, steps) = (self.envs, play.settings.n_steps);
        self.pay(play, steps - 1);
        play.networks.forward(play.parameters, &mut self.pass, envs, |out| {
            observe(play, &self.place.rows().observations, out);
        });
        let (gamma, lambda) = (play.settings.gamma as f32, play.settings.gae_lambda as f32);
        let data = &mut self.data;
        for i in 0..envs {
            let (mut next, mut advantage) = (self.pass.values[i], 0.0);
            for row in (0..steps).rev().map(|step| step * envs + i) {
                let goes_on = if self.ended[row] { 0.0 } else { 1.0 };
                let surprise = data.rewards[row] + gamma * next * goes_on - data.values[row];
                advantage = surprise + gamma * lambda * goes_on * advantage;
                next = data.values[row];
                data.advantages[row] = advantage;
                data.returns[row] = advantage + next;
            }
        }
    }
}

/// Observations in the form that the networks take.
fn observe(play: &PolicyContext, rows: &[f32], out: &mut [f32]) {
    match play.scales {
        Some(scales) => scales.observations(rows, out),
        None => out.copy_from_slice(rows),
    }
}

/// Distributes rows over the pieces of environments.
pub fn deal<P: DerefMut<Target = RolloutGroup>>(
    pieces: impl Iterator<Item = P>,
    rows: &Rows,
    mut hand: impl FnMut(&mut RolloutGroup, Rows),
) {
    let mut first = 0;
    for mut piece in pieces {
        let part = first..first + piece.envs;
        first = part.end;
        hand(&mut piece, of_part(rows, part));
    }
}
