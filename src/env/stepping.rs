//! A control step, in parts of some milliseconds: with the shortest time step it takes a tenth of a second. Other
//! sessions have their turns between the parts, and a step that nobody waits for any more ends there.

use super::episode::Environment;
use super::shard::Shard;
use super::unfinished::UnfinishedStep;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Number of time steps between two looks at the clock: our choice, a control step with the default time step.
const CHUNK: usize = 20;

impl Shard {
    /// Makes one control step of every environment; `actions` is f32 [envs, action] within its bounds. If an episode
    /// ends, the next episode begins at once, and the row has the first observation of the next episode.
    pub fn step(&mut self, actions: &[f32]) {
        self.step_part(actions, |_| false, Duration::MAX);
    }

    /// The same as [`Shard::step`], except for environments for which `held` is true. Those keep their state, and their rows
    /// are zeros except for the observation. Because lanes advance together, held environments also make the step and are then
    /// restored.
    pub fn step_but(&mut self, actions: &[f32], held: impl Fn(usize) -> bool) {
        self.step_part(actions, held, Duration::MAX);
    }

    /// Goes on with a [`Shard::step_but`] for about `time`; returns whether it is done. Until then the arguments must be
    /// the same. Results do not depend on the division into parts.
    pub fn step_part(&mut self, actions: &[f32], held: impl Fn(usize) -> bool, time: Duration) -> bool {
        let mut step = match self.unfinished.take() {
            Some(step) => step,
            None => self.begin_step(actions, held),
        };
        if !self.advance(&mut step, time) {
            self.unfinished = Some(step);
            return false;
        }
        let width = self.actions();
        for i in 0..self.envs() {
            self.finish(i, &actions[i * width..][..width]);
        }
        for (i, episode) in step.held {
            self.rows.clear_env(i);
            self.restore(i, &episode);
        }
        true
    }

    fn begin_step(&mut self, actions: &[f32], held: impl Fn(usize) -> bool) -> UnfinishedStep {
        let held = (0..self.envs()).filter(|i| held(*i)).map(|i| (i, self.keep(i))).collect();
        self.rows.clear();
        let width = self.actions();
        for (i, Environment { episode, before, ended, .. }) in self.environments.iter_mut().enumerate() {
            *ended = None;
            std::mem::swap(before, &mut episode.state);
            let mut action = &actions[i * width..][..width];
            if !episode.delay.is_none() {
                episode.delay.push(action);
                action = episode.delay.first();
            }
            episode.task.command(action, before, &mut self.command);
            self.engine.command(i, &self.command);
        }
        let arrivals = self.environments.iter().filter_map(|e| e.episode.delay.second().map(|(at, _)| at));
        let mut arrivals: Vec<usize> = arrivals.collect();
        arrivals.sort_unstable();
        arrivals.dedup();
        UnfinishedStep { arrivals, arrived: 0, now: 0, begun: false, held }
    }

    /// Advances all environments for about `time`; returns whether the control step is over. An action that arrives in
    /// the middle of the step acts from its arrival on.
    fn advance(&mut self, step: &mut UnfinishedStep, time: Duration) -> bool {
        let start = Instant::now();
        loop {
            let arrival = step.arrivals.get(step.arrived).copied();
            let end = arrival.unwrap_or(self.substeps);
            if !step.begun {
                self.engine.begin_part(end - step.now);
                step.begun = true;
            }
            let steps = (end - step.now).min(CHUNK);
            step.now += steps;
            let is_over = step.now == end;
            self.engine.go_on(steps, is_over && arrival.is_none());
            if is_over && arrival.is_none() {
                return true;
            }
            if is_over {
                self.arrive(step.now);
                (step.begun, step.arrived) = (false, step.arrived + 1);
            }
            if start.elapsed() >= time {
                return false;
            }
        }
    }

    /// Gives the actions that arrive at time step `now` to the servos.
    fn arrive(&mut self, now: usize) {
        for (i, Environment { episode, .. }) in self.environments.iter_mut().enumerate() {
            let Some((_, action)) = episode.delay.second().filter(|(at, _)| *at == now) else { continue };
            self.engine.state(i, &mut episode.state);
            episode.task.command(action, &episode.state, &mut self.command);
            self.engine.command(i, &self.command);
        }
    }

    /// Keeps copies of all environments, so that [`Shard::undo`] can restore them.
    pub fn keep_all(&mut self) {
        self.kept = (0..self.envs()).map(|i| self.environments[i].begun.then(|| self.keep(i))).collect();
    }

    /// The present operation is done, and will not be undone.
    pub fn settle(&mut self) {
        self.kept = Vec::new();
    }

    /// Ends the present operation, and restores the environments that were kept.
    pub fn undo(&mut self) {
        self.unfinished = None;
        self.rows.clear();
        for (i, kept) in std::mem::take(&mut self.kept).into_iter().enumerate() {
            match kept {
                // A model with rocks takes milliseconds, and most episodes go on in a step.
                Some(episode) if Arc::ptr_eq(episode.model(), self.environments[i].episode.model()) => {
                    self.put_back(i, &episode);
                }
                Some(episode) => self.restore(i, &episode),
                None => self.environments[i].begun = false,
            }
        }
    }

    /// Has a control step begun that is not finished?
    pub fn is_in_step(&self) -> bool {
        self.unfinished.is_some()
    }

    /// Does environment `i` have a state?
    pub fn is_begun(&self, i: usize) -> bool {
        self.environments[i].begun
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry::{Blueprint, TASK_IDS};
    use serde_json::json;

    /// A step in the smallest parts has the bits of a step in one part, in every task and with actions that arrive late.
    #[test]
    fn parts_change_no_bit() {
        for task in TASK_IDS {
            let options = json!({"dt": 2.5e-4, "action_delay": [0.003, 0.017]});
            let blueprint = Blueprint::new(task, options).unwrap();
            let envs = blueprint.engine.shard_size();
            let seeds: Vec<u64> = (0..envs as u64).collect();
            let begun = || {
                let mut shard = Shard::new(&blueprint, envs).unwrap();
                shard.reset(|_| true, Some(&seeds), |_| None);
                shard
            };
            let [mut whole, mut divided] = [begun(), begun()];
            for step in 0..5 {
                let action = |k: usize| ((k * 3 + step) as f32 * 0.37).sin();
                let actions: Vec<f32> = (0..envs * whole.actions()).map(action).collect();
                whole.step(&actions);
                let mut parts = 1;
                while !divided.step_part(&actions, |_| false, Duration::ZERO) {
                    parts += 1;
                }
                assert!(parts > 3, "{task}: {parts} parts");
                assert_eq!(whole.rows, divided.rows, "{task}");
                (0..envs).for_each(|i| assert_eq!(whole.state(i), divided.state(i), "{task}"));
            }
        }
    }

    /// A step that is undone in the middle leaves the bits of the next steps as they were.
    #[test]
    fn an_undone_step_leaves_no_trace() {
        for task in TASK_IDS {
            let blueprint = Blueprint::new(task, json!({"dt": 2.5e-4})).unwrap();
            let envs = blueprint.engine.shard_size();
            let seeds: Vec<u64> = (0..envs as u64).collect();
            let begun = || {
                let mut shard = Shard::new(&blueprint, envs).unwrap();
                shard.reset(|_| true, Some(&seeds), |_| None);
                shard.step(&vec![0.3; envs * shard.actions()]);
                shard
            };
            let [mut calm, mut undone] = [begun(), begun()];
            let actions = vec![-0.2; envs * calm.actions()];
            for parts in [1, 2, 100] {
                undone.keep_all();
                for _ in 0..parts {
                    if undone.step_part(&actions, |_| false, Duration::ZERO) {
                        break;
                    }
                }
                undone.undo();
                assert!(!undone.is_in_step());
                calm.step(&actions);
                undone.step(&actions);
                assert_eq!(calm.rows, undone.rows, "{task} after {parts} parts");
            }
        }
    }
}
