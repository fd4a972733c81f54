//! One environment for viewers.

use super::episode::{Environment, Episode};
use super::shard::Shard;
use super::spec::Spec;
use super::task::{TaskState, Transition};
use crate::sand::memory::Moved;
use crate::sim::pose::foot_loads;
use crate::sim::{Model, State};
use std::sync::Arc;

/// State of an environment after its last reset or step, and the step's info.
pub struct EnvView<'a> {
    pub spec: &'a Spec,
    pub model: &'a Arc<Model>,
    pub state: &'a State,
    pub task_state: &'a TaskState,
    /// The sand that was moved; None without memory, and for an episode that has ended.
    pub sand: Option<&'a Moved>,
    /// Factor on the stress on each leg, 1 on fresh ground; empty if all ground is fresh.
    pub footing: &'a [f64],
    /// Seed and number of the episode.
    pub episode: (u64, u64),
    /// Time since the episode began [s].
    pub time: f64,
    pub action: &'a [f32],
    pub reward: f32,
    pub info: Vec<f32>,
}

impl EnvView<'_> {
    /// The state with the sand that was moved.
    pub fn whole_state(&self) -> State {
        State { sand: self.sand.cloned().map(Box::new), ..self.state.clone() }
    }
}

impl Shard {
    /// The state of environment `i`. If `ended` is true and an episode ended in the last step, this is the last state
    /// of that episode; otherwise the present one.
    pub fn look(&self, i: usize, ended: bool) -> EnvView<'_> {
        let spec = self.spec();
        let Environment { episode, before, ended: last, .. } = &self.environments[i];
        let Episode { task, seed, number, steps, task_state, state, last_action, .. } = episode;
        let just_ended = self.rows.terminated[i] != 0 || self.rows.truncated[i] != 0;
        let old = last.as_ref().filter(|_| ended && just_ended);
        let (task_state, steps, action) = match old {
            Some(old) => (&old.task_state, old.steps, &old.action),
            None => (task_state, *steps, last_action),
        };
        // Rewards and figures of a step that ended an episode do not belong to the start of the next episode.
        let begins = steps == 0 || (just_ended && old.is_none());
        let width = spec.info.len();
        let info = if begins { at_start(episode, spec) } else { self.rows.infos[i * width..][..width].to_vec() };
        EnvView {
            spec,
            model: task_state.model.as_ref().unwrap_or(task.model()),
            state: if old.is_some() { before } else { state },
            task_state,
            sand: if old.is_some() { None } else { self.engine.sand(i) },
            footing: task_state.ground.as_ref().map_or(&[], |g| &g.footing),
            episode: (*seed, number - u64::from(old.is_some())),
            time: f64::from(steps) / spec.control_rate,
            action,
            reward: if begins { 0.0 } else { self.rows.rewards[i] },
            info,
        }
    }
}

/// The figures of an episode's first state, such as its commands. They are computed as for a step in which nothing
/// moves, with no reward.
fn at_start(episode: &Episode, spec: &Spec) -> Vec<f32> {
    let mut info = vec![0.0; spec.info.len()];
    let Episode { task, task_state, state, last_action, .. } = episode;
    let still = Transition {
        model: episode.model(),
        task_state,
        before: state,
        after: state,
        foot_loads: &foot_loads(episode.model(), state),
        action: last_action,
        previous_action: last_action,
        period: 1.0 / spec.control_rate,
        diverged: false,
    };
    task.evaluate(&still, &mut info);
    info[..spec.reward.len()].fill(0.0);
    info.iter_mut().filter(|x| !x.is_finite()).for_each(|x| *x = 0.0);
    info
}
