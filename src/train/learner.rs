//! A training: rollouts and updates in turn, both spread over threads.
//!
//! ```text
//!  pieces ──act, act, …, finish──▶ rollout ──chunks of a minibatch──▶ gradient ──▶ parameters
//!    ▲                                                                                │
//!    └────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! All random numbers are functions of the seed and the update's number, and all sums have a fixed order. So a training
//! that a number of steps ends, and not a time, is bit-identical on any number of threads of one instruction set.

use super::crew;
use super::plan::{Observer, TrainingPlan, TrainingState};
use super::remote::OptionalRemote;
use super::training::Training;
use super::work::{Phase, TrainingWork};
use crate::error::Result;
use crate::number::flushed;

impl TrainingPlan {
    /// Continues from `learnt` until the limit of steps or time, with environments in this process or those of
    /// `remote`.
    pub fn run(
        &self,
        learnt: TrainingState,
        mut remote: OptionalRemote<'_>,
        observer: &mut dyn Observer,
    ) -> Result<TrainingState> {
        let shared = TrainingWork::new(self, &learnt, remote.as_deref_mut(), observer)?;
        let work = |phase: Phase, item: usize| flushed(|| shared.work(phase, item));
        let mut training = Training::new(self, &shared, learnt, remote);
        crew::with(self.threads, &work, |crew| {
            while training.done() < 1.0 {
                let report = flushed(|| training.update(crew, observer))?;
                observer.update(&training.learnt, &report)?;
            }
            Ok(())
        })?;
        Ok(training.learnt)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::plan::tests::plan;
    use crate::plan::{TrainingState, UpdateReport};
    use serde_json::json;

    /// The result is bit-identical for any number of threads, and differs for another seed.
    #[test]
    fn threads_change_nothing() {
        let entry = json!({
            "n_envs": 80, "n_steps": 4, "n_timesteps": 1280, "batch_size": 200, "n_epochs": 2, "normalize": true,
            "mirror": true, "policy_kwargs": {"net_arch": [16]},
        });
        let learn = |threads: usize, seed: u64| {
            let mut plan = plan(&entry, threads);
            plan.seed = seed;
            let mut learnt = plan.run(plan.begin(), None, &mut |_: &TrainingState, report: &UpdateReport| {
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

    /// Stops a training at its pause number `left`, and keeps the state after the last update.
    struct Break {
        left: usize,
        last: TrainingState,
    }

    impl Observer for Break {
        fn update(&mut self, learnt: &TrainingState, _: &UpdateReport) -> Result<()> {
            self.last = learnt.clone();
            Ok(())
        }

        fn pause(&mut self) -> Result<()> {
            self.left = self.left.checked_sub(1).ok_or_else(|| Error::Cancelled("stopped".into()))?;
            Ok(())
        }
    }

    /// A training that is interrupted anywhere continues bit-identically from its last update.
    #[test]
    fn what_is_broken_off_goes_on_with_the_same_bits() {
        let entry = json!({
            "n_envs": 24, "n_steps": 5, "n_timesteps": 600, "batch_size": 60, "n_epochs": 2, "normalize": true,
            "policy_kwargs": {"net_arch": [8]},
        });
        let plan = plan(&entry, 2);
        let timeless = |learnt: TrainingState| TrainingState { seconds: 0.0, ..learnt };
        let whole = timeless(plan.run(plan.begin(), None, &mut |_: &TrainingState, _: &UpdateReport| Ok(())).unwrap());
        // An update has nine or ten pauses: in a rollout, during learning, at its end.
        for left in [11, 16, 25, 38] {
            let mut observer = Break { left, last: plan.begin() };
            assert!(plan.run(plan.begin(), None, &mut observer).is_err());
            assert!((1..5).contains(&observer.last.updates), "{left}: {}", observer.last.updates);
            let went_on = plan.run(observer.last, None, &mut |_: &TrainingState, _: &UpdateReport| Ok(())).unwrap();
            assert!(timeless(went_on) == whole, "{left}");
        }
    }

    /// If the learning rate is far too large, the earlier parameters are kept, and the message suggests a remedy.
    #[test]
    fn what_is_not_finite_ends_the_training() {
        let entry = json!({
            "n_envs": 16, "n_steps": 4, "n_timesteps": 640_000, "batch_size": 64, "learning_rate": 1e3,
            "max_grad_norm": 1e9, "normalize_advantage": false,
        });
        let plan = plan(&entry, 1);
        let mut last = plan.begin();
        let error = plan.run(plan.begin(), None, &mut |learnt: &TrainingState, _: &UpdateReport| {
            last = learnt.clone();
            Ok(())
        });
        let error = error.unwrap_err().to_string();
        assert!(error.contains("is not a number after") && error.contains("learning_rate than 1000"), "{error}");
        assert!(last.parameters.iter().all(|p| p.is_finite()));
    }
}
