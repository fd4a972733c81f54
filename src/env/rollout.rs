//! Many steps in one go: with actions that are known beforehand, for planners and evolution strategies, or with those of a
//! policy that runs beside the environments.
//!
//! An environment's rollout ends with its episode: what it would do after that counts nothing and is reported as zeros.

use super::shard::Shard;
use crate::error::Error;

/// What a rollout gave so far; one row an environment.
#[derive(Default)]
pub struct Rollout {
    /// f64 [envs]: sum of rewards until the rollout or the episode ended.
    pub returns: Vec<f64>,
    /// [envs]: steps that counted.
    pub lengths: Vec<u32>,
    /// [envs], 0 or 1: how the episode ended, if it did.
    pub terminated: Vec<u8>,
    /// [envs], 0 or 1
    pub truncated: Vec<u8>,
    /// Every step since the last call, where they were asked for.
    pub steps: Vec<Recorded>,
    /// Why there are no actions for the next step; none are made after that.
    pub failed: Option<Error>,
}

/// One step of a rollout, zeros where an environment's rollout had ended before.
pub struct Recorded {
    /// f32 [envs, observation]: after the step; the last of its episode where that ended.
    pub observations: Vec<f32>,
    /// f32 [envs]
    pub rewards: Vec<f32>,
    /// f32 [envs, action]: what the step was made with.
    pub actions: Vec<f32>,
}

impl Rollout {
    fn begin(envs: usize) -> Self {
        Self {
            returns: vec![0.0; envs],
            lengths: vec![0; envs],
            terminated: vec![0; envs],
            truncated: vec![0; envs],
            steps: Vec::new(),
            failed: None,
        }
    }

    fn over(&self, i: usize) -> bool {
        self.terminated[i] + self.truncated[i] > 0
    }
}

impl Shard {
    /// Before the first [`Shard::roll`] of a rollout.
    pub fn begin_rollout(&mut self) {
        self.rollout = Rollout::begin(self.envs());
    }

    /// Goes on with a rollout by one step; `actions` is f32 [envs, action] within its bounds.
    pub fn roll(&mut self, actions: &[f32], record: bool) {
        let over: Vec<bool> = (0..self.envs()).map(|i| self.rollout.over(i)).collect();
        self.step(actions);
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
    }

    /// The last step's rows, zeros where `over`.
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
