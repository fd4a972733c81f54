//! What a shard's last reset or step returned.

/// Rows of the last reset or step, one for each environment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// f32 [envs, observation]
    pub observations: Vec<f32>,
    /// f32 [envs]
    pub rewards: Vec<f32>,
    /// [envs], 0 or 1
    pub terminated: Vec<u8>,
    /// [envs], 0 or 1
    pub truncated: Vec<u8>,
    /// f32 [envs, info]
    pub infos: Vec<f32>,
    /// Indices of the environments of this shard whose episode ended in this step, in ascending order.
    pub ended: Vec<u32>,
    /// f32 [ended, observation]: last row of each ended episode.
    pub final_observations: Vec<f32>,
}

impl Rows {
    pub(super) fn new(envs: usize, observation: usize, info: usize) -> Self {
        Self {
            observations: vec![0.0; envs * observation],
            rewards: vec![0.0; envs],
            terminated: vec![0; envs],
            truncated: vec![0; envs],
            infos: vec![0.0; envs * info],
            ended: Vec::with_capacity(envs),
            final_observations: Vec::with_capacity(envs * observation),
        }
    }

    /// Clears the rows for the next call.
    pub fn clear(&mut self) {
        self.rewards.fill(0.0);
        self.terminated.fill(0);
        self.truncated.fill(0);
        self.infos.fill(0.0);
        self.ended.clear();
        self.final_observations.clear();
    }

    /// Clears the buffers of environment `i` alone.
    pub(super) fn clear_env(&mut self, i: usize) {
        let envs = self.rewards.len();
        let (wide, info) = (self.observations.len() / envs, self.infos.len() / envs);
        self.rewards[i] = 0.0;
        (self.terminated[i], self.truncated[i]) = (0, 0);
        self.infos[i * info..][..info].fill(0.0);
        if let Some(k) = self.ended.iter().position(|e| *e as usize == i) {
            self.ended.remove(k);
            self.final_observations.drain(k * wide..(k + 1) * wide);
        }
    }
}
