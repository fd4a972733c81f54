//! The plan of a training, its state, and the interface of its observers.

use super::adam::Adam;
use super::collect::PolicyContext;
use super::mirror::{self, Mirror};
use super::network::{NetworkSizes, Networks};
use super::normal::{Normalizer, NormalizerScales};
use super::saved_environments::SavedEnvironments;
use super::settings::Hyperparameters;
use super::spec::TrainingSpec;
use super::teacher::Teacher;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::number::Isa;
use rand::SeedableRng as _;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::sync::Arc;

/// Largest number of values in the observations and actions of a rollout: our choice, 4 GiB.
const MOST_NUMBERS: usize = 1 << 30;

/// The state of a training: everything that is needed to continue it.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingState {
    pub parameters: Vec<f32>,
    pub adam: Adam,
    pub normal: Option<Normalizer>,
    /// Number of environment steps.
    pub steps: u64,
    /// Number of rollouts, each with its updates.
    pub updates: u64,
    /// Duration of the training so far [s].
    pub seconds: f64,
    /// Saved environments; without them new episodes begin.
    pub environments: Option<Arc<SavedEnvironments>>,
}

/// Observes a training. An error of an observer ends the training.
pub trait Observer {
    /// Called after each update.
    fn update(&mut self, learnt: &TrainingState, report: &UpdateReport) -> Result<()>;

    /// Called within an update, every few milliseconds.
    fn pause(&mut self) -> Result<()> {
        Ok(())
    }
}

impl<F: FnMut(&TrainingState, &UpdateReport) -> Result<()>> Observer for F {
    fn update(&mut self, learnt: &TrainingState, report: &UpdateReport) -> Result<()> {
        self(learnt, report)
    }
}

/// The environments, networks and settings of a training.
pub struct TrainingPlan {
    pub spec: TrainingSpec,
    pub settings: Hyperparameters,
    pub networks: Networks,
    /// What the policy first imitates.
    pub teacher: Option<Teacher>,
    /// Sentences on what the training does without having been told to.
    pub notes: Vec<String>,
    pub seed: u64,
    pub threads: usize,
}

/// Results of an update.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UpdateReport {
    pub steps: u64,
    pub seconds: f64,
    /// Finished share of the training, 0 to 1.
    pub done: f64,
    /// Mean return of the episodes that ended in the rollout; NaN if none did.
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
    /// Mean level of the task's curriculum at the end of the rollout; None if it has none.
    pub level: Option<f64>,
    /// The name of each reward term of `info`, and its mean per step.
    pub terms: Vec<(String, f64)>,
}

impl TrainingPlan {
    pub fn new(blueprint: Blueprint, settings: Hyperparameters, seed: u64, threads: usize) -> Result<Self> {
        let mut notes = Vec::new();
        let mirror = match (settings.mirror, Mirror::both(&blueprint)) {
            (Some(false), _) => None,
            (_, Ok(mirror)) => {
                let own = Mirror::notes(&blueprint);
                if settings.mirror.is_none() && own.is_empty() {
                    notes.push("left and right are learnt together (--set mirror=false: apart)".into());
                }
                notes.extend(own);
                Some(mirror)
            }
            (Some(true), Err(reason)) => return Err(reason),
            (None, Err(reason)) => {
                let reason = reason.to_string();
                let reason = reason.strip_suffix(mirror::REMEDY).unwrap_or(&reason);
                notes.push(format!("left and right are learnt apart: {reason}"));
                None
            }
        };
        let teacher = Teacher::of(&blueprint, &settings)?;
        let plan = Self::with(TrainingSpec::of_task(blueprint), mirror, settings, [seed, threads as u64])?;
        Ok(Self { teacher, notes, ..plan })
    }

    /// The plan for another program's environments.
    pub fn external(spec: TrainingSpec, settings: Hyperparameters, [seed, threads]: [u64; 2]) -> Result<Self> {
        if settings.mirror == Some(true) {
            return Err(Error::invalid("mirror", "left and right are known for the program's own tasks only"));
        }
        let numbers = (settings.n_envs * settings.n_steps).saturating_mul(spec.observation.len() + spec.action.len());
        if numbers > MOST_NUMBERS {
            let reason = format!("{numbers} numbers in a rollout are more than {MOST_NUMBERS}");
            return Err(Error::invalid("n_envs · n_steps · (observation + action)", reason));
        }
        Self::with(spec, None, settings, [seed, threads])
    }

    fn with(
        spec: TrainingSpec,
        mirror: Option<[Mirror; 2]>,
        settings: Hyperparameters,
        [seed, threads]: [u64; 2],
    ) -> Result<Self> {
        let shape = NetworkSizes::new(spec.observation.len(), spec.action.len(), &settings.net_arch);
        let settings = Hyperparameters { mirror: Some(mirror.is_some()), ..settings };
        let networks = Networks { shape, mirror, isa: Isa::choose()? };
        let threads = (threads as usize).max(1);
        Ok(Self { spec, settings, networks, teacher: None, notes: Vec::new(), seed, threads })
    }

    /// The initial state.
    pub fn begin(&self) -> TrainingState {
        let shape = &self.networks.shape;
        let parameters = shape.begin(self.settings.log_std_init as f32, &mut self.random(0, u64::MAX));
        TrainingState {
            adam: Adam::new(parameters.len()),
            parameters,
            normal: self.settings.normalize.then(|| Normalizer::new(shape.observation)),
            steps: 0,
            updates: 0,
            seconds: 0.0,
            environments: None,
        }
    }

    /// The initial state, but with the networks and the normalization of `other`.
    pub fn begin_from(&self, other: &TrainingState) -> TrainingState {
        TrainingState { parameters: other.parameters.clone(), normal: other.normal.clone(), ..self.begin() }
    }

    /// Does the policy imitate its teacher in update `update`?
    pub(crate) fn imitates(&self, update: u64) -> bool {
        let samples = (self.settings.n_envs * self.settings.n_steps) as u64;
        self.teacher.is_some() && update.saturating_mul(samples) < self.settings.gait_prior
    }

    /// What the pieces need to play with these parameters.
    pub(crate) fn context<'a>(
        &'a self,
        parameters: &'a [f32],
        scales: Option<&'a NormalizerScales>,
    ) -> PolicyContext<'a> {
        let Self { settings, networks, teacher, .. } = self;
        PolicyContext { settings, networks, teacher: teacher.as_ref(), parameters, scales }
    }

    /// Random numbers for purpose `what` in update `update`.
    pub(crate) fn random(&self, update: u64, what: u64) -> Xoshiro256PlusPlus {
        Xoshiro256PlusPlus::seed_from_u64(self.noise(update, what))
    }

    pub(crate) fn noise(&self, update: u64, what: u64) -> u64 {
        // The factors are odd, and the generator mixes its seed, so two purposes of a training practically never
        // have the same stream.
        self.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ update.wrapping_mul(0xd1b5_4a32_d192_ed03)
            ^ what.wrapping_mul(0x8cb9_2ba7_2f3d_8dd7)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use serde_json::{Value, json};

    pub fn plan(entry: &Value, threads: usize) -> TrainingPlan {
        let blueprint = Blueprint::new("sandgait/HexapodGait-v1", json!({"max_episode_steps": 7})).unwrap();
        TrainingPlan::new(blueprint, Hyperparameters::from_entry(entry.as_object().unwrap()).unwrap(), 5, threads)
            .unwrap()
    }
}
