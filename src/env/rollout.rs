//! Many steps in one call, with given actions (for planners and evolution strategies) or with the actions of a
//! policy that runs in the process of the environments.
//!
//! An environment's rollout ends with its episode. Later steps are not counted, and their rows are zeros.

use crate::error::Error;

/// Results of a rollout so far; one row for each environment.
#[derive(Default)]
pub struct Rollout {
    /// f64 [envs]: sum of rewards until the rollout or the episode ended.
    pub returns: Vec<f64>,
    /// [envs]: number of counted steps.
    pub lengths: Vec<u32>,
    /// [envs], 0 or 1: how the episode ended, if it ended.
    pub terminated: Vec<u8>,
    /// [envs], 0 or 1
    pub truncated: Vec<u8>,
    /// Every step since the last call, if requested.
    pub steps: Vec<Recorded>,
    /// The error because of which the policy has no action for the next step; no further steps are made.
    pub failed: Option<Error>,
}

/// One step of a rollout; zeros for environments whose rollout had ended.
pub struct Recorded {
    /// f32 [envs, observation]: after the step, or at the end of the episode.
    pub observations: Vec<f32>,
    /// f32 [envs]
    pub rewards: Vec<f32>,
    /// f32 [envs, action]: the action of the step.
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

    pub(super) fn is_over(&self, i: usize) -> bool {
        self.terminated[i] + self.truncated[i] > 0
    }
}
