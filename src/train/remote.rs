//! Environments on a server, from which the training gets the same rows as from environments in this process.

use crate::error::Result;
use std::ops::Range;

/// Called while waiting for an answer; its error ends the wait.
pub type WhileWaiting<'a> = &'a mut dyn FnMut() -> Result<()>;

/// All environments of a training, on a server. Each call waits for its answer.
pub trait RemoteEnvironments: Send {
    /// Begins an episode in each environment; one seed for each environment.
    fn reset(&mut self, seeds: &[u64], pause: WhileWaiting) -> Result<RemoteRows>;
    /// Makes a step; `actions` is f32 [envs, action]. If an episode ends, the next one begins at once.
    fn step(&mut self, actions: &[f32], pause: WhileWaiting) -> Result<RemoteRows>;
    /// Saves all environments.
    fn save(&mut self, pause: WhileWaiting) -> Result<Vec<u8>>;
    /// Restores saved environments.
    fn restore(&mut self, snapshot: &[u8], pause: WhileWaiting) -> Result<RemoteRows>;
}

/// Environments on a server, if the training uses one.
pub type OptionalRemote<'a> = Option<&'a mut (dyn RemoteEnvironments + 'static)>;

/// Rows of the last reset or step, one for each environment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RemoteRows {
    /// f32 [envs, observation]
    pub observations: Vec<f32>,
    /// f32 [envs]
    pub rewards: Vec<f32>,
    /// [envs], 0 or 1
    pub terminated: Vec<u8>,
    /// [envs], 0 or 1
    pub truncated: Vec<u8>,
    /// Environments whose episode ended in this step, ascending.
    pub ended: Vec<u32>,
    /// f32 [ended, observation]: last row of each ended episode.
    pub final_observations: Vec<f32>,
}

impl RemoteRows {
    /// The rows of the environments in `part`, counted from its start.
    pub fn part(&self, part: Range<usize>) -> Self {
        let wide = self.observations.len() / self.rewards.len().max(1);
        let ended: Vec<usize> = (0..self.ended.len()).filter(|k| part.contains(&(self.ended[*k] as usize))).collect();
        Self {
            observations: self.observations[part.start * wide..part.end * wide].to_vec(),
            rewards: self.rewards[part.clone()].to_vec(),
            terminated: self.terminated[part.clone()].to_vec(),
            truncated: self.truncated[part.clone()].to_vec(),
            ended: ended.iter().map(|k| self.ended[*k] - part.start as u32).collect(),
            final_observations: ended
                .iter()
                .flat_map(|k| &self.final_observations[k * wide..][..wide])
                .copied()
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_counted_from_their_start() {
        let rows = RemoteRows {
            observations: (0..10).map(|k| k as f32).collect(),
            rewards: vec![0.0, 1.0, 2.0, 3.0, 4.0],
            terminated: vec![0, 1, 0, 0, 0],
            truncated: vec![0, 0, 0, 1, 1],
            ended: vec![1, 3, 4],
            final_observations: vec![10.0, 11.0, 30.0, 31.0, 40.0, 41.0],
        };
        let part = rows.part(2..4);
        let wanted = RemoteRows {
            observations: vec![4.0, 5.0, 6.0, 7.0],
            rewards: vec![2.0, 3.0],
            terminated: vec![0, 0],
            truncated: vec![0, 1],
            ended: vec![1],
            final_observations: vec![30.0, 31.0],
        };
        assert_eq!(part, wanted);
    }
}
