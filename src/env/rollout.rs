//! Many steps with actions that are known beforehand, for planners and evolution strategies.
//!
//! An environment's rollout ends with its episode: what it would do after that counts nothing and is reported as zeros.

use super::shard::Shard;

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
}

/// One step of a rollout, zeros where an environment's rollout had ended before.
pub struct Recorded {
    /// f32 [envs, observation]: after the step; the last of its episode where that ended.
    pub observations: Vec<f32>,
    /// f32 [envs]
    pub rewards: Vec<f32>,
}

impl Rollout {
    fn begin(envs: usize) -> Self {
        Self {
            returns: vec![0.0; envs],
            lengths: vec![0; envs],
            terminated: vec![0; envs],
            truncated: vec![0; envs],
            steps: Vec::new(),
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
            let step = self.recorded(&over);
            self.rollout.steps.push(step);
        }
    }

    /// The last step's rows, zeros where `over`.
    fn recorded(&self, over: &[bool]) -> Recorded {
        let rows = &self.rows;
        let wide = rows.observations.len() / over.len();
        let mut step = Recorded { observations: rows.observations.clone(), rewards: rows.rewards.clone() };
        for (i, last) in rows.ended.iter().zip(rows.final_observations.chunks_exact(wide)) {
            step.observations[*i as usize * wide..][..wide].copy_from_slice(last);
        }
        for i in (0..over.len()).filter(|i| over[*i]) {
            step.observations[i * wide..][..wide].fill(0.0);
            step.rewards[i] = 0.0;
        }
        step
    }
}
