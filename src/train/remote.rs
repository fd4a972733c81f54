//! Remote environments: they are on a server or in another program, and give a training the same rows as its own
//! environments.

use crate::env::shard::Rows;
use crate::error::Result;
use std::ops::Range;

/// Called while waiting for an answer; its error ends the wait.
pub type Pause<'a> = &'a mut dyn FnMut() -> Result<()>;

/// All environments of a training, on a server or of another program. Each call waits for its answer.
pub trait RemoteEnvironments: Send {
    /// Begins an episode in each environment; one seed for each environment.
    fn reset(&mut self, seeds: &[u64], pause: Pause) -> Result<Rows>;
    /// Makes a step; `actions` is f32 [envs, action]. If an episode ends, the next one begins at once.
    fn step(&mut self, actions: &[f32], pause: Pause) -> Result<Rows>;
    /// Saves all environments; None if they cannot be saved.
    fn save(&mut self, pause: Pause) -> Result<Option<Vec<u8>>>;
    /// Restores saved environments.
    fn restore(&mut self, snapshot: &[u8], pause: Pause) -> Result<Rows>;

    /// One flag for each environment: did it ignore its action in the last step, because this step began its next
    /// episode? Empty if no environment ever does this. The training does not learn from such a step.
    fn skipped(&self) -> &[bool] {
        &[]
    }

    /// Mean per step of each reward term since the last call of this function; None: the rows' infos have the task's
    /// terms.
    fn terms(&mut self) -> Result<Option<Vec<(String, f64)>>> {
        Ok(None)
    }

    /// What went wrong and was repaired, one sentence each.
    fn notices(&self) -> Vec<String> {
        Vec::new()
    }
}

/// Remote environments, if the training uses any.
pub type OptionalRemote<'a> = Option<&'a mut (dyn RemoteEnvironments + 'static)>;

/// The rows of the environments in `part`, counted from its start.
pub fn of_part(rows: &Rows, part: Range<usize>) -> Rows {
    let [wide, info] = [&rows.observations, &rows.infos].map(|all| all.len() / rows.rewards.len().max(1));
    let ended = || (0..rows.ended.len()).filter(|k| part.contains(&(rows.ended[*k] as usize)));
    Rows {
        observations: rows.observations[part.start * wide..part.end * wide].to_vec(),
        rewards: rows.rewards[part.clone()].to_vec(),
        terminated: rows.terminated[part.clone()].to_vec(),
        truncated: rows.truncated[part.clone()].to_vec(),
        infos: rows.infos[part.start * info..part.end * info].to_vec(),
        ended: ended().map(|k| rows.ended[k] - part.start as u32).collect(),
        final_observations: ended().flat_map(|k| &rows.final_observations[k * wide..][..wide]).copied().collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_counted_from_their_start() {
        let rows = Rows {
            observations: (0..10).map(|k| k as f32).collect(),
            rewards: vec![0.0, 1.0, 2.0, 3.0, 4.0],
            terminated: vec![0, 1, 0, 0, 0],
            truncated: vec![0, 0, 0, 1, 1],
            infos: vec![0.1, 0.2, 0.3, 0.4, 0.5],
            ended: vec![1, 3, 4],
            final_observations: vec![10.0, 11.0, 30.0, 31.0, 40.0, 41.0],
        };
        let part = of_part(&rows, 2..4);
        let wanted = Rows {
            observations: vec![4.0, 5.0, 6.0, 7.0],
            rewards: vec![2.0, 3.0],
            terminated: vec![0, 0],
            truncated: vec![0, 1],
            infos: vec![0.3, 0.4],
            ended: vec![1],
            final_observations: vec![30.0, 31.0],
        };
        assert_eq!(part, wanted);
    }
}
