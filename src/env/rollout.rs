//! Many steps in one go: with actions that are known beforehand, for planners and evolution strategies, or with those of a
//! policy that runs beside the environments.
//!
//! An environment's rollout ends with its episode: what it would do after that counts nothing and is reported as zeros.

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
    pub(super) fn begin(envs: usize) -> Self {
        Self {
            returns: vec![0.0; envs],
            lengths: vec![0; envs],
            terminated: vec![0; envs],
            truncated: vec![0; envs],
            steps: Vec::new(),
            failed: None,
        }
    }

    pub(super) fn over(&self, i: usize) -> bool {
        self.terminated[i] + self.truncated[i] > 0
    }
}
