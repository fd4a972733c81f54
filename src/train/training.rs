//! The loop of a training: rollout, update, rollout, …

use super::collect::{RolloutGroup, deal};
use super::crew::WorkCrew;
use super::loss::{LossSums, LossWeights, entropy};
use super::normal::{BatchMoments, RunningStatistics};
use super::plan::{Observer, TrainingPlan, TrainingState, UpdateReport};
use super::remote::OptionalRemote;
use super::saved_environments::SavedEnvironments;
use super::settings::Hyperparameters;
use super::work::{Phase, TrainingWork};
use crate::error::{Error, Result};
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Instant;

/// The state of a training in its leader's thread.
pub struct Training<'a, 'r> {
    plan: &'a TrainingPlan,
    shared: &'a TrainingWork<'a>,
    pub learnt: TrainingState,
    remote: OptionalRemote<'r>,
    began: Instant,
    /// Duration of the training before this run [s].
    before: f64,
    /// Duration of the rollouts [s].
    rollouts: f64,
}

impl<'a, 'r> Training<'a, 'r> {
    pub fn new(
        plan: &'a TrainingPlan,
        shared: &'a TrainingWork<'a>,
        learnt: TrainingState,
        remote: OptionalRemote<'r>,
    ) -> Self {
        let before = learnt.seconds;
        Self { plan, shared, learnt, remote, began: Instant::now(), before, rollouts: 0.0 }
    }

    /// Finished share of the training after the last update: of its steps or of its time, whichever is larger. The time is the one that
    /// is reported, so a training that has ended has reported all of its time.
    pub fn done(&self) -> f64 {
        let settings = &self.plan.settings;
        let steps = self.learnt.steps as f64 / settings.n_timesteps as f64;
        let time = settings.seconds.map_or(0.0, |seconds| self.learnt.seconds / seconds);
        steps.max(time).min(1.0)
    }

    /// A rollout and its update. After an error `learnt` cannot be used any more.
    pub fn update(&mut self, crew: &WorkCrew<'_, Phase>, observer: &mut dyn Observer) -> Result<UpdateReport> {
        let done = self.done();
        let start = Instant::now();
        let (finished, explained_variance) = self.roll(crew, observer)?;
        self.rollouts += start.elapsed().as_secs_f64();
        let settings = &self.plan.settings;
        let rate = settings.learning_rate.at(done);
        let sums = self.learn(crew, observer, done, rate)?;
        self.learnt.updates += 1;
        let remote = self.remote.as_deref_mut();
        self.learnt.environments =
            SavedEnvironments::of(&self.shared.pieces, remote, &mut || observer.pause())?.map(Arc::new);
        self.learnt.parameters.clone_from(&self.shared.parameters.read());
        self.learnt.seconds = self.before + self.began.elapsed().as_secs_f64();
        let log_std = &self.learnt.parameters[self.plan.networks.shape.log_std.clone()];
        let mean = |sum: f64| sum / sums.samples.max(1.0);
        Ok(UpdateReport {
            steps: self.learnt.steps,
            seconds: self.learnt.seconds,
            done: self.done(),
            mean_return: finished.iter().sum::<f64>() / finished.len() as f64,
            episodes: finished.len(),
            learning_rate: rate,
            policy_loss: mean(sums.policy),
            value_loss: mean(sums.value),
            entropy: f64::from(entropy(log_std)),
            kl: mean(sums.kl),
            clip_fraction: mean(sums.clipped),
            explained_variance,
            deviation: log_std.iter().map(|s| f64::from(s.exp())).sum::<f64>() / log_std.len() as f64,
            simulation: self.rollouts / self.began.elapsed().as_secs_f64(),
            level: self.level(),
            terms: self.terms()?,
        })
    }

    /// Mean level of the environments' curriculum.
    fn level(&self) -> Option<f64> {
        let levels = self.shared.pieces.iter().flat_map(|piece| piece.lock().levels.clone());
        let (sum, count) = levels.fold((0.0, 0), |(sum, count), level| (sum + f64::from(level), count + 1));
        (count > 0).then(|| sum / f64::from(count))
    }

    /// Each weighted reward term with its mean over the rollout's steps.
    fn terms(&mut self) -> Result<Vec<(String, f64)>> {
        if let Some(remote) = self.remote.as_deref_mut()
            && let Some(terms) = remote.terms()?
        {
            return Ok(terms);
        }
        let Hyperparameters { n_envs, n_steps, .. } = self.plan.settings;
        let spec = self.plan.spec.task()?.task.spec();
        let sum = |k: usize| self.shared.pieces.iter().map(|piece| piece.lock().terms[k]).sum::<f64>();
        let mean = |k: usize| (spec.info[k].name.clone(), sum(k) / (n_envs * n_steps) as f64);
        Ok((0..spec.reward.len()).map(mean).collect())
    }

    /// Fills the rollout; gives the returns of the episodes that ended, and the explained variance of the values.
    fn roll(&mut self, crew: &WorkCrew<'_, Phase>, observer: &mut dyn Observer) -> Result<(Vec<f64>, f64)> {
        let (settings, pieces) = (&self.plan.settings, &self.shared.pieces);
        let imitates = self.plan.imitates(self.learnt.updates);
        for (k, piece) in pieces.iter().enumerate() {
            piece.lock().begin(self.plan.noise(self.learnt.updates, k as u64), imitates);
        }
        if self.learnt.steps == 0 {
            self.normalize(false);
        }
        self.reflect_statistics();
        for step in 0..settings.n_steps {
            crew.run(Phase::Act { step }, pieces.len());
            self.step_away(step, observer)?;
            self.normalize(true);
            observer.pause()?;
        }
        crew.run(Phase::Finish, pieces.len());
        self.learnt.steps += (settings.n_envs * settings.n_steps) as u64;
        let mut rollout = self.shared.rollout.write();
        rollout.clear();
        let mut finished = Vec::new();
        for piece in pieces {
            let mut piece = piece.lock();
            let RolloutGroup { data, skipped, .. } = &mut *piece;
            rollout.append(data, skipped);
            finished.append(&mut piece.finished);
        }
        Ok((finished, rollout.explained_variance()))
    }

    /// Makes step `step` of remote environments: sends the pieces' actions, and gives the results to the pieces.
    fn step_away(&mut self, step: usize, observer: &mut dyn Observer) -> Result<()> {
        let Some(remote) = &mut self.remote else { return Ok(()) };
        let pieces = &self.shared.pieces;
        let actions: Vec<f32> = pieces.iter().flat_map(|piece| piece.lock().clipped.clone()).collect();
        let rows = remote.step(&actions, &mut || observer.pause())?;
        let (parameters, scales) = (self.shared.parameters.read(), self.shared.scales.read());
        let play = self.plan.context(&parameters, scales.as_ref());
        let mut skipped = remote.skipped();
        deal(pieces.iter().map(Mutex::lock), &rows, |piece, part| {
            let own = skipped.split_off(..piece.envs.min(skipped.len())).unwrap_or_default();
            piece.answered(&play, step, part, own);
        });
        Ok(())
    }

    /// Updates the statistics with the last observations of all pieces, and with their rewards if there are any.
    fn normalize(&mut self, rewarded: bool) {
        let Some(normal) = &mut self.learnt.normal else { return };
        let join = |what: usize| {
            let mut all: Option<BatchMoments> = None;
            for piece in &self.shared.pieces {
                let piece = piece.lock();
                match &mut all {
                    None => all = Some(piece.seen[what].clone()),
                    Some(all) => all.join(&piece.seen[what]),
                }
            }
            all
        };
        let update = |running: &mut RunningStatistics, what: usize| {
            join(what).iter().for_each(|moments| running.update(moments));
        };
        update(&mut normal.observations, 0);
        if rewarded {
            update(&mut normal.returns, 1);
        }
        *self.shared.scales.write() = Some(normal.scales());
    }

    /// Keeps the statistics symmetric; otherwise normalized rows would not be mirror images of each other.
    fn reflect_statistics(&mut self) {
        let Some(normal) = &mut self.learnt.normal else { return };
        if let Some([mirror, _]) = &self.plan.networks.mirror {
            let RunningStatistics { mean, variance, .. } = &mut normal.observations;
            let (old_mean, old_variance) = (mean.clone(), variance.clone());
            for (k, (from, sign)) in mirror.order.iter().zip(&mirror.signs).enumerate() {
                mean[k] = 0.5 * (old_mean[k] + f64::from(*sign) * old_mean[*from]);
                variance[k] = 0.5 * (old_variance[k] + old_variance[*from]);
            }
        }
        *self.shared.scales.write() = Some(normal.scales());
    }

    /// Runs all epochs; returns the sums over all minibatches.
    fn learn(
        &mut self,
        crew: &WorkCrew<'_, Phase>,
        observer: &mut dyn Observer,
        done: f64,
        rate: f64,
    ) -> Result<LossSums> {
        let (plan, shared) = (self.plan, self.shared);
        let settings = &plan.settings;
        let imitates = plan.imitates(self.learnt.updates);
        let most = settings.most_log_std(done, self.level().unwrap_or(1.0));
        let rows = shared.rollout.read().rows();
        let mut random = plan.random(self.learnt.updates, u64::MAX - 1);
        let mut all = LossSums::default();
        for _ in 0..settings.n_epochs {
            shared.minibatches.write().shuffle(rows, &mut random);
            for first in (0..rows).step_by(settings.batch_size) {
                let (samples, chunks) = {
                    let mut minibatches = shared.minibatches.write();
                    let rollout = shared.rollout.read();
                    let samples = minibatches.take(&rollout, first, settings.batch_size, settings.normalize_advantage);
                    (samples, minibatches.chunks())
                };
                let weights = LossWeights {
                    clip: settings.clip_range.at(done) as f32,
                    clip_value: settings.clip_range_vf.map(|clip| clip.at(done) as f32),
                    value: settings.vf_coef as f32,
                    imitates,
                    samples,
                };
                crew.run(Phase::Learn { weights }, chunks);
                let (mut gradient, sums) = self.gather(chunks);
                all += sums;
                if settings.target_kl.is_some_and(|target| sums.kl / sums.samples > 1.5 * target) {
                    return Ok(all);
                }
                // The derivative of the entropy by each logarithm of a deviation is 1.
                let entropy = if imitates { 0.0 } else { settings.ent_coef as f32 };
                gradient[plan.networks.shape.log_std.clone()].iter_mut().for_each(|g| *g -= entropy);
                let mut parameters = shared.parameters.write();
                let norm =
                    self.learnt.adam.step(&mut parameters, &gradient, rate, settings.max_grad_norm, plan.networks.isa);
                let deviations = &mut parameters[plan.networks.shape.log_std.clone()];
                deviations.iter_mut().for_each(|own| *own = own.min(most));
                if !(norm.is_finite() && (sums.policy + sums.value).is_finite()) {
                    return Err(self.diverged(rate));
                }
                drop(parameters);
                observer.pause()?;
            }
        }
        Ok(all)
    }

    /// The gradient of a minibatch: the sum of the gradients of its chunks, in their order.
    fn gather(&self, chunks: usize) -> (Vec<f32>, LossSums) {
        let mut sums = LossSums::default();
        let mut gradient = vec![0.0; self.plan.networks.shape.parameters];
        for chunk in &self.shared.chunks[..chunks] {
            let chunk = chunk.lock();
            gradient.iter_mut().zip(&chunk.gradient).for_each(|(sum, g)| *sum += g);
            sums += chunk.sums;
        }
        (gradient, sums)
    }

    fn diverged(&self, rate: f64) -> Error {
        let steps = self.learnt.steps;
        Error::invalid(
            "training",
            format!(
                "loss or gradient is not a number after {steps} steps; a smaller learning_rate than {rate} may help"
            ),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crew;
    use serde_json::json;

    /// The inputs that tests/python/test_from_rust.py gives to SB3's PPO, whose results are `sb3_update.json`.
    #[test]
    fn an_update_is_sb3_s() {
        let rows = 64;
        let entry = json!({
            "n_envs": 16, "n_steps": 4, "batch_size": rows, "n_epochs": 3, "learning_rate": 1e-3, "clip_range_vf": 0.3,
            "ent_coef": 0.01, "policy_kwargs": {"net_arch": [8, 7], "log_std_init": -0.3},
        });
        let plan = crate::plan::tests::plan(&entry, 1);
        let mut learnt = plan.begin();
        let wave = |x: &mut [f32], size: f64, pitch: f64, shift: f64| {
            x.iter_mut().enumerate().for_each(|(k, x)| *x = (size * (pitch * k as f64).sin() + shift) as f32);
        };
        let weights = plan.networks.shape.log_std.start;
        wave(&mut learnt.parameters[..weights], 0.4, 1.1, 0.0);
        let mut observer = |_: &TrainingState, _: &UpdateReport| Ok(());
        let shared = TrainingWork::new(&plan, &learnt, None, &mut observer).unwrap();
        {
            let mut rollout = shared.rollout.write();
            wave(&mut rollout.observations, 1.5, 0.37, 0.1);
            wave(&mut rollout.actions, 1.2, 0.71, 0.0);
            wave(&mut rollout.log_probabilities, 0.4, 1.9, -6.0);
            wave(&mut rollout.values, 0.5, 0.53, 0.0);
            wave(&mut rollout.advantages, 2.0, 0.91, 0.3);
            wave(&mut rollout.returns, 1.0, 0.77, 0.2);
        }
        let before = learnt.parameters.clone();
        let mut training = Training::new(&plan, &shared, learnt, None);
        let work = |phase: Phase, item: usize| shared.work(phase, item);
        let sums = crew::with(1, &work, |crew| training.learn(crew, &mut observer, 0.0, 1e-3)).unwrap();
        assert_eq!(sums.samples, 3.0 * rows as f64);
        let wanted: Vec<f64> = serde_json::from_str(include_str!("../../tests/data/train/sb3_update.json")).unwrap();
        let got = shared.parameters.read();
        assert_eq!(got.len(), wanted.len());
        let moved = got.iter().zip(&before).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(moved > 2e-3, "three steps of Adam move by the rate each");
        for (k, (got, wanted)) in got.iter().zip(&wanted).enumerate() {
            // If a derivative is nearly zero, Adam amplifies its rounding error, up to a hundredth of a step.
            assert!((f64::from(*got) - wanted).abs() < 1e-5, "parameter {k}: {got} {wanted}");
        }
    }
}
