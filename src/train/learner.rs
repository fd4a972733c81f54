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
use super::crew;
use super::kept::Kept;
use super::mirror::Mirror;
use super::network::{Networks, Shape};
use super::normal::Normal;
use super::remote::Away;
use super::settings::Settings;
use super::training::{Phase, Shared, Training};
use crate::env::registry::Blueprint;
use crate::error::Result;
use crate::number::{Isa, flushed};
use rand::SeedableRng as _;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::sync::Arc;

/// What has been learnt, and everything that going on takes.
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
    /// Without them new episodes begin.
    pub environments: Option<Arc<Kept>>,
}

/// Hears of a training, which ends with an error of it.
pub trait Heed {
    /// After each update: what has been learnt, and how.
    fn update(&mut self, learnt: &Learnt, report: &Report) -> Result<()>;

    /// Within an update, every few milliseconds.
    fn pause(&mut self) -> Result<()> {
        Ok(())
    }
}

impl<F: FnMut(&Learnt, &Report) -> Result<()>> Heed for F {
    fn update(&mut self, learnt: &Learnt, report: &Report) -> Result<()> {
        self(learnt, report)
    }
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
            environments: None,
        }
    }

    /// Random numbers for purpose `what` in update `update`.
    pub(crate) fn random(&self, update: u64, what: u64) -> Xoshiro256PlusPlus {
        Xoshiro256PlusPlus::seed_from_u64(self.noise(update, what))
    }

    pub(crate) fn noise(&self, update: u64, what: u64) -> u64 {
        // Odd factors, and the generator mixes its seed: no two purposes of a training meet in practice.
        self.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ update.wrapping_mul(0xd1b5_4a32_d192_ed03)
            ^ what.wrapping_mul(0x8cb9_2ba7_2f3d_8dd7)
    }

    /// Goes on from `learnt` until steps or time are up, with the environments in this process or of `remote`.
    pub fn run(&self, learnt: Learnt, mut remote: Away<'_>, heed: &mut dyn Heed) -> Result<Learnt> {
        let shared = Shared::new(self, &learnt, remote.as_deref_mut(), heed)?;
        let work = |phase: Phase, item: usize| flushed(|| shared.work(phase, item));
        let mut training = Training::new(self, &shared, learnt, remote);
        crew::with(self.threads, &work, |crew| {
            while training.done() < 1.0 {
                let report = flushed(|| training.update(crew, heed))?;
                heed.update(&training.learnt, &report)?;
            }
            Ok(())
        })?;
        Ok(training.learnt)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::error::Error;
    use serde_json::{Value, json};

    pub fn plan(entry: &Value, threads: usize) -> Plan {
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", json!({"max_episode_steps": 7})).unwrap();
        Plan::new(blueprint, Settings::from_entry(entry.as_object().unwrap()).unwrap(), 5, threads).unwrap()
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
            let mut learnt = plan.run(plan.begin(), None, &mut |_: &Learnt, report: &Report| {
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

    /// Ends a training in its pause number `left`, and keeps what was there after the last update.
    struct Break {
        left: usize,
        last: Learnt,
    }

    impl Heed for Break {
        fn update(&mut self, learnt: &Learnt, _: &Report) -> Result<()> {
            self.last = learnt.clone();
            Ok(())
        }

        fn pause(&mut self) -> Result<()> {
            self.left = self.left.checked_sub(1).ok_or_else(|| Error::Cancelled("stopped".into()))?;
            Ok(())
        }
    }

    /// Wherever a training is broken off, it goes on from its last update as if nothing had been.
    #[test]
    fn what_is_broken_off_goes_on_with_the_same_bits() {
        let entry = json!({
            "n_envs": 24, "n_steps": 5, "n_timesteps": 600, "batch_size": 60, "n_epochs": 2, "normalize": true,
            "policy_kwargs": {"net_arch": [8]},
        });
        let plan = plan(&entry, 2);
        let timeless = |learnt: Learnt| Learnt { seconds: 0.0, ..learnt };
        let whole = timeless(plan.run(plan.begin(), None, &mut |_: &Learnt, _: &Report| Ok(())).unwrap());
        // Nine pauses or ten an update: in a rollout, in the middle of learning, at an update's end.
        for left in [11, 16, 25, 38] {
            let mut heed = Break { left, last: plan.begin() };
            assert!(plan.run(plan.begin(), None, &mut heed).is_err());
            assert!((1..5).contains(&heed.last.updates), "{left}: {}", heed.last.updates);
            let went_on = plan.run(heed.last, None, &mut |_: &Learnt, _: &Report| Ok(())).unwrap();
            assert!(timeless(went_on) == whole, "{left}");
        }
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
        let error = plan.run(plan.begin(), None, &mut |learnt: &Learnt, _: &Report| {
            last = learnt.clone();
            Ok(())
        });
        let error = error.unwrap_err().to_string();
        assert!(error.contains("is not a number after") && error.contains("learning_rate than 1000"), "{error}");
        assert!(last.parameters.iter().all(|p| p.is_finite()));
    }
}
