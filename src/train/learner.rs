//! A training: rollouts and updates in turn, both spread over threads.
//!
//! ```text
//!  pieces ──act, act, …, finish──▶ rollout ──chunks of a minibatch──▶ gradient ──▶ parameters
//!    ▲                                                                                │
//!    └────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! All random numbers are functions of seed and number of the update, and all sums have an order of their own: a training is
//! the same to the bit on any number of threads of one instruction set, if steps and not seconds end it.

use super::adam::Adam;
use super::collect::{Piece, Play};
use super::crew::{self, Crew};
use super::learn::{Chunk, Minibatches, Rollout};
use super::loss::{Sums, Weights, entropy};
use super::mirror::Mirror;
use super::network::{Networks, Shape};
use super::normal::{Moments, Normal, Running, Scales};
use super::settings::Settings;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::number::{Isa, flushed};
use rand::SeedableRng as _;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::Instant;

/// Where seeds of trainings begin: none that an evaluation takes.
const FIRST_SEED: u64 = 1 << 40;

/// What has been learnt, and everything that going on takes but the environments.
#[derive(Clone, Debug, PartialEq)]
pub struct Learnt {
    pub parameters: Vec<f32>,
    pub adam: Adam,
    pub normal: Option<Normal>,
    /// Steps of environments.
    pub steps: u64,
    /// Rollouts, each with its updates.
    pub updates: u64,
    /// Time that it took [s].
    pub seconds: f64,
}

/// What is to be learnt, and how.
pub struct Plan {
    pub blueprint: Blueprint,
    pub settings: Settings,
    pub networks: Networks,
    pub seed: u64,
    pub threads: usize,
}

/// What an update came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    pub steps: u64,
    pub seconds: f64,
    /// Share of the training that is done, 0 to 1.
    pub done: f64,
    /// Mean sum of rewards of the episodes that ended in the rollout; not a number if none did.
    pub mean_return: f64,
    pub episodes: usize,
    pub learning_rate: f64,
    pub policy_loss: f64,
    pub value_loss: f64,
    pub entropy: f64,
    pub kl: f64,
    pub clip_fraction: f64,
    pub explained_variance: f64,
    /// Mean standard deviation of an action's numbers.
    pub deviation: f64,
    /// Share of the training's time that the rollouts took.
    pub simulation: f64,
}

impl Plan {
    pub fn new(blueprint: Blueprint, settings: Settings, seed: u64, threads: usize) -> Result<Self> {
        let spec = blueprint.task.spec();
        let shape = Shape::new(spec.observation.len(), spec.action.len(), &settings.net_arch);
        let mirror = settings.mirror.then(|| Mirror::both(spec)).transpose()?;
        let networks = Networks { shape, mirror, isa: Isa::choose()? };
        Ok(Self { blueprint, settings, networks, seed, threads: threads.max(1) })
    }

    /// Nothing learnt yet.
    pub fn begin(&self) -> Learnt {
        let shape = &self.networks.shape;
        let parameters = shape.begin(self.settings.log_std_init as f32, &mut self.random(0, u64::MAX));
        Learnt {
            adam: Adam::new(parameters.len()),
            parameters,
            normal: self.settings.normalize.then(|| Normal::new(shape.observation)),
            steps: 0,
            updates: 0,
            seconds: 0.0,
        }
    }

    /// Random numbers for purpose `what` in update `update`.
    fn random(&self, update: u64, what: u64) -> Xoshiro256PlusPlus {
        Xoshiro256PlusPlus::seed_from_u64(self.noise(update, what))
    }

    fn noise(&self, update: u64, what: u64) -> u64 {
        // Odd factors, and the generator mixes its seed: no two purposes of a training meet in practice.
        self.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ update.wrapping_mul(0xd1b5_4a32_d192_ed03)
            ^ what.wrapping_mul(0x8cb9_2ba7_2f3d_8dd7)
    }

    /// Goes on from `learnt` until steps or time are up. After each update `heed` is told what has been learnt and how; an
    /// error of it ends the training.
    pub fn run(&self, learnt: Learnt, mut heed: impl FnMut(&Learnt, &Report) -> Result<()>) -> Result<Learnt> {
        let shared = Shared::new(self, &learnt)?;
        let work = |phase: Phase, item: usize| flushed(|| shared.work(phase, item));
        let mut training =
            Training { plan: self, shared: &shared, learnt, began: Instant::now(), before: 0.0, rollouts: 0.0 };
        training.before = training.learnt.seconds;
        crew::with(self.threads, &work, |crew| {
            while training.done() < 1.0 {
                let report = flushed(|| training.update(crew))?;
                heed(&training.learnt, &report)?;
            }
            Ok(())
        })?;
        Ok(training.learnt)
    }
}

/// What threads work on. Phases take turns, so nobody waits for these locks.
struct Shared<'a> {
    plan: &'a Plan,
    parameters: RwLock<Vec<f32>>,
    scales: RwLock<Option<Scales>>,
    pieces: Vec<Mutex<Piece>>,
    rollout: RwLock<Rollout>,
    minibatches: RwLock<Minibatches>,
    chunks: Vec<Mutex<Chunk>>,
}

#[derive(Clone, Copy)]
enum Phase {
    /// A step of the rollout; one item a piece.
    Act { step: usize },
    /// Its end; one item a piece.
    Finish,
    /// The gradient of a minibatch; one item a chunk.
    Learn { weights: Weights },
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

impl<'a> Shared<'a> {
    fn new(plan: &'a Plan, learnt: &Learnt) -> Result<Self> {
        let Plan { blueprint, settings, networks, .. } = plan;
        // Whoever goes on meets other episodes than before.
        let begun = learnt.updates.wrapping_mul(settings.n_envs as u64) & u64::from(u32::MAX);
        let first_seed = FIRST_SEED.wrapping_add(plan.seed << 32).wrapping_add(begun);
        let pieces = Piece::all(blueprint, settings, networks, first_seed)?;
        let shape = &networks.shape;
        let chunks = settings.batch_size.div_ceil(super::learn::CHUNK);
        Ok(Self {
            plan,
            parameters: RwLock::new(learnt.parameters.clone()),
            scales: RwLock::new(None),
            pieces: pieces.into_iter().map(Mutex::new).collect(),
            rollout: RwLock::new(Rollout::new(settings.n_envs * settings.n_steps, shape.observation, shape.action)),
            minibatches: RwLock::default(),
            chunks: (0..chunks).map(|_| Mutex::new(Chunk::new(networks))).collect(),
        })
    }

    fn work(&self, phase: Phase, item: usize) {
        let Plan { settings, networks, .. } = self.plan;
        let parameters = read(&self.parameters);
        match phase {
            Phase::Learn { weights } => {
                let (rollout, minibatches) = (read(&self.rollout), read(&self.minibatches));
                lock(&self.chunks[item]).learn(networks, &parameters, &rollout, &minibatches, item, &weights);
            }
            Phase::Act { .. } | Phase::Finish => {
                let scales = read(&self.scales);
                let play = Play { settings, networks, parameters: &parameters, scales: scales.as_ref() };
                let mut piece = lock(&self.pieces[item]);
                match phase {
                    Phase::Act { step } => piece.act(&play, step),
                    _ => piece.finish(&play),
                }
            }
        }
    }
}

/// A training under way, as its leader sees it.
struct Training<'a> {
    plan: &'a Plan,
    shared: &'a Shared<'a>,
    learnt: Learnt,
    began: Instant,
    /// Time of earlier parts [s].
    before: f64,
    /// Time that rollouts took [s].
    rollouts: f64,
}

impl Training<'_> {
    /// Share of the training that is done: of its steps or its time, whichever is further.
    fn done(&self) -> f64 {
        let settings = &self.plan.settings;
        let steps = self.learnt.steps as f64 / settings.n_timesteps as f64;
        let time = settings.seconds.map_or(0.0, |seconds| (self.before + self.began.elapsed().as_secs_f64()) / seconds);
        steps.max(time).min(1.0)
    }

    /// A rollout and what is learnt from it.
    fn update(&mut self, crew: &Crew<'_, Phase>) -> Result<Report> {
        let done = self.done();
        let start = Instant::now();
        let (finished, explained_variance) = self.roll(crew);
        self.rollouts += start.elapsed().as_secs_f64();
        let settings = &self.plan.settings;
        let rate = settings.learning_rate.at(done);
        let kept = (read(&self.shared.parameters).clone(), self.learnt.adam.clone());
        let outcome = self.learn(crew, done, rate);
        let Ok((sums, minibatches)) = outcome else {
            // What was sound stays.
            (self.learnt.parameters, self.learnt.adam) = kept;
            return Err(self.diverged(rate));
        };
        self.learnt.updates += 1;
        self.learnt.parameters.clone_from(&read(&self.shared.parameters));
        self.learnt.seconds = self.before + self.began.elapsed().as_secs_f64();
        let log_std = &self.learnt.parameters[self.plan.networks.shape.log_std.clone()];
        let mean = |sum: f64| sum / sums.samples.max(1.0);
        debug_assert!(minibatches > 0);
        Ok(Report {
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
        })
    }

    /// Fills the rollout; gives the returns of the episodes that ended, and how well they had been foreseen.
    fn roll(&mut self, crew: &Crew<'_, Phase>) -> (Vec<f64>, f64) {
        let (settings, pieces) = (&self.plan.settings, &self.shared.pieces);
        for (k, piece) in pieces.iter().enumerate() {
            lock(piece).begin(self.plan.noise(self.learnt.updates, k as u64));
        }
        if self.learnt.steps == 0 {
            self.normalize(false);
        }
        self.reflect_statistics();
        for step in 0..settings.n_steps {
            crew.run(Phase::Act { step }, pieces.len());
            self.normalize(true);
        }
        crew.run(Phase::Finish, pieces.len());
        self.learnt.steps += (settings.n_envs * settings.n_steps) as u64;
        let mut rollout = write(&self.shared.rollout);
        rollout.clear();
        let mut finished = Vec::new();
        for piece in pieces {
            let mut piece = lock(piece);
            rollout.append(&mut piece.data);
            finished.append(&mut piece.finished);
        }
        (finished, rollout.explained_variance())
    }

    /// Takes account of what all pieces have just seen, of rewards too if there are some.
    fn normalize(&mut self, rewarded: bool) {
        let Some(normal) = &mut self.learnt.normal else { return };
        let join = |what: usize| {
            let mut all: Option<Moments> = None;
            for piece in &self.shared.pieces {
                let piece = lock(piece);
                match &mut all {
                    None => all = Some(piece.seen[what].clone()),
                    Some(all) => all.join(&piece.seen[what]),
                }
            }
            all
        };
        let update = |running: &mut Running, what: usize| {
            join(what).iter().for_each(|moments| running.update(moments));
        };
        update(&mut normal.observations, 0);
        if rewarded {
            update(&mut normal.returns, 1);
        }
        *write(&self.shared.scales) = Some(normal.scales());
    }

    /// Keeps the statistics symmetric; else normalized rows would not be mirror images of each other.
    fn reflect_statistics(&mut self) {
        let Some(normal) = &mut self.learnt.normal else { return };
        if let Some([mirror, _]) = &self.plan.networks.mirror {
            let Running { mean, variance, .. } = &mut normal.observations;
            let (old_mean, old_variance) = (mean.clone(), variance.clone());
            for (k, (from, sign)) in mirror.order.iter().zip(&mirror.signs).enumerate() {
                mean[k] = 0.5 * (old_mean[k] + f64::from(*sign) * old_mean[*from]);
                variance[k] = 0.5 * (old_variance[k] + old_variance[*from]);
            }
        }
        *write(&self.shared.scales) = Some(normal.scales());
    }

    /// All epochs; gives the sums over all minibatches and their number, and nothing where a number is not finite.
    fn learn(&mut self, crew: &Crew<'_, Phase>, done: f64, rate: f64) -> std::result::Result<(Sums, usize), ()> {
        let (plan, shared) = (self.plan, self.shared);
        let settings = &plan.settings;
        let rows = settings.n_envs * settings.n_steps;
        let mut random = plan.random(self.learnt.updates, u64::MAX - 1);
        let (mut all, mut count) = (Sums::default(), 0);
        for _ in 0..settings.n_epochs {
            write(&shared.minibatches).shuffle(rows, &mut random);
            for first in (0..rows).step_by(settings.batch_size) {
                let (samples, chunks) = {
                    let mut minibatches = write(&shared.minibatches);
                    let rollout = read(&shared.rollout);
                    let samples = minibatches.take(&rollout, first, settings.batch_size, settings.normalize_advantage);
                    (samples, minibatches.chunks())
                };
                let weights = Weights {
                    clip: settings.clip_range.at(done) as f32,
                    clip_value: settings.clip_range_vf.map(|clip| clip.at(done) as f32),
                    value: settings.vf_coef as f32,
                    samples,
                };
                crew.run(Phase::Learn { weights }, chunks);
                let (mut gradient, sums) = self.gather(chunks);
                all += sums;
                count += 1;
                if settings.target_kl.is_some_and(|target| sums.kl / sums.samples > 1.5 * target) {
                    return Ok((all, count));
                }
                // The entropy's slope by each logarithm of a deviation is 1.
                gradient[plan.networks.shape.log_std.clone()].iter_mut().for_each(|g| *g -= settings.ent_coef as f32);
                let mut parameters = write(&shared.parameters);
                let norm =
                    self.learnt.adam.step(&mut parameters, &gradient, rate, settings.max_grad_norm, plan.networks.isa);
                if !(norm.is_finite() && (sums.policy + sums.value).is_finite()) {
                    return Err(());
                }
            }
        }
        Ok((all, count))
    }

    /// The gradient of a minibatch from those of its chunks, in their order.
    fn gather(&self, chunks: usize) -> (Vec<f32>, Sums) {
        let mut sums = Sums::default();
        let mut gradient = vec![0.0; self.plan.networks.shape.parameters];
        for chunk in &self.shared.chunks[..chunks] {
            let chunk = lock(chunk);
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
    use serde_json::{Value, json};

    fn plan(entry: &Value, threads: usize) -> Plan {
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", json!({"max_episode_steps": 7})).unwrap();
        Plan::new(blueprint, Settings::from_entry(entry.as_object().unwrap()).unwrap(), 5, threads).unwrap()
    }

    /// The numbers that tests/python/test_from_rust.py gives SB3's PPO, which made `sb3_update.json` of them.
    #[test]
    fn an_update_is_sb3_s() {
        let rows = 64;
        let entry = json!({
            "n_envs": 16, "n_steps": 4, "batch_size": rows, "n_epochs": 3, "learning_rate": 1e-3, "clip_range_vf": 0.3,
            "ent_coef": 0.01, "policy_kwargs": {"net_arch": [8, 7], "log_std_init": -0.3},
        });
        let plan = plan(&entry, 1);
        let mut learnt = plan.begin();
        let wave = |x: &mut [f32], size: f64, pitch: f64, shift: f64| {
            x.iter_mut().enumerate().for_each(|(k, x)| *x = (size * (pitch * k as f64).sin() + shift) as f32);
        };
        let weights = plan.networks.shape.log_std.start;
        wave(&mut learnt.parameters[..weights], 0.4, 1.1, 0.0);
        let shared = Shared::new(&plan, &learnt).unwrap();
        {
            let mut rollout = write(&shared.rollout);
            wave(&mut rollout.observations, 1.5, 0.37, 0.1);
            wave(&mut rollout.actions, 1.2, 0.71, 0.0);
            wave(&mut rollout.log_probabilities, 0.4, 1.9, -6.0);
            wave(&mut rollout.values, 0.5, 0.53, 0.0);
            wave(&mut rollout.advantages, 2.0, 0.91, 0.3);
            wave(&mut rollout.returns, 1.0, 0.77, 0.2);
        }
        let before = learnt.parameters.clone();
        let mut training =
            Training { plan: &plan, shared: &shared, learnt, began: Instant::now(), before: 0.0, rollouts: 0.0 };
        let work = |phase: Phase, item: usize| shared.work(phase, item);
        let (sums, count) = crew::with(1, &work, |crew| training.learn(crew, 0.0, 1e-3)).unwrap();
        assert_eq!((sums.samples, count), (3.0 * rows as f64, 3));
        let wanted: Vec<f64> = serde_json::from_str(include_str!("../../tests/data/train/sb3_update.json")).unwrap();
        let got = read(&shared.parameters);
        assert_eq!(got.len(), wanted.len());
        let moved = got.iter().zip(&before).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(moved > 2e-3, "three steps of Adam move by the rate each");
        for (k, (got, wanted)) in got.iter().zip(&wanted).enumerate() {
            // Where a slope is nearly zero, Adam makes much of its rounding: a hundredth of a step.
            assert!((f64::from(*got) - wanted).abs() < 1e-5, "parameter {k}: {got} {wanted}");
        }
    }

    /// Any number of threads learns the same, to the bit; another seed does not.
    #[test]
    fn threads_change_nothing() {
        let entry = json!({
            "n_envs": 80, "n_steps": 4, "n_timesteps": 1280, "batch_size": 200, "n_epochs": 2, "normalize": true,
            "mirror": true, "policy_kwargs": {"net_arch": [16]},
        });
        let learn = |threads: usize, seed: u64| {
            let mut plan = plan(&entry, threads);
            plan.seed = seed;
            let mut learnt = plan.run(plan.begin(), |_, report| {
                assert!(report.value_loss.is_finite() && report.kl.is_finite());
                Ok(())
            });
            learnt.iter_mut().for_each(|learnt| learnt.seconds = 0.0);
            learnt.unwrap()
        };
        let one = learn(1, 5);
        assert_eq!((one.steps, one.updates), (1280, 4));
        assert_eq!(one, learn(3, 5));
        assert_ne!(one.parameters, learn(1, 6).parameters);
    }

    /// A rate far too large: the parameters of before are kept, and the message says what to do.
    #[test]
    fn what_is_not_finite_ends_the_training() {
        let entry = json!({
            "n_envs": 16, "n_steps": 4, "n_timesteps": 640_000, "batch_size": 64, "learning_rate": 1e3,
            "max_grad_norm": 1e9, "normalize_advantage": false,
        });
        let plan = plan(&entry, 1);
        let mut last = plan.begin();
        let error = plan.run(plan.begin(), |learnt, _| {
            last = learnt.clone();
            Ok(())
        });
        let error = error.unwrap_err().to_string();
        assert!(error.contains("is not a number after") && error.contains("learning_rate than 1000"), "{error}");
        assert!(last.parameters.iter().all(|p| p.is_finite()));
    }
}
