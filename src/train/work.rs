//! What the threads of a training share, and their work in each phase.

use super::collect::{RolloutGroup, deal};
use super::learn::{Chunk, Minibatches, RolloutBuffer};
use super::loss::LossWeights;
use super::normal::NormalizerScales;
use super::plan::{Observer, TrainingPlan, TrainingState};
use super::remote::OptionalRemote;
use crate::error::Result;
use parking_lot::{Mutex, RwLock};

/// Start of the trainings' seeds; evaluations use none of them.
const FIRST_SEED: u64 = 1 << 40;

/// Work of the threads. Phases follow each other, so no thread waits for these locks.
pub struct TrainingWork<'a> {
    plan: &'a TrainingPlan,
    pub parameters: RwLock<Vec<f32>>,
    pub scales: RwLock<Option<NormalizerScales>>,
    pub pieces: Vec<Mutex<RolloutGroup>>,
    pub rollout: RwLock<RolloutBuffer>,
    pub minibatches: RwLock<Minibatches>,
    pub chunks: Vec<Mutex<Chunk>>,
}

#[derive(Clone, Copy)]
pub enum Phase {
    /// A step of the rollout; one item for each piece.
    Act { step: usize },
    /// The end of the rollout; one item for each piece.
    Finish,
    /// The gradient of a minibatch; one item a chunk.
    Learn { weights: LossWeights },
}

impl<'a> TrainingWork<'a> {
    /// Continues with the environments in `learnt`, or begins new episodes.
    pub fn new(
        plan: &'a TrainingPlan,
        learnt: &TrainingState,
        mut remote: OptionalRemote<'_>,
        observer: &mut dyn Observer,
    ) -> Result<Self> {
        let TrainingPlan { spec, settings, networks, .. } = plan;
        let mut pieces = RolloutGroup::all(spec, settings, networks, remote.is_some())?;
        let mut pause = || observer.pause();
        match &learnt.environments {
            Some(kept) => kept.restore(&mut pieces, spec, remote.as_deref_mut(), &mut pause)?,
            None => {
                // A training that continues without its environments gets other episodes than before.
                let begun = learnt.updates.wrapping_mul(settings.n_envs as u64) & u64::from(u32::MAX);
                let first = FIRST_SEED.wrapping_add(plan.seed << 32).wrapping_add(begun);
                let seeds: Vec<u64> = (first..).take(settings.n_envs).collect();
                match remote {
                    Some(remote) => {
                        let rows = remote.reset(&seeds, &mut pause)?;
                        deal(pieces.iter_mut(), &rows, |piece, part| piece.take(part));
                    }
                    None => {
                        let mut seeds = &seeds[..];
                        for piece in &mut pieces {
                            piece.reset(seeds.split_off(..piece.envs).unwrap_or_default());
                        }
                    }
                }
            }
        }
        let shape = &networks.shape;
        let chunks = settings.batch_size.div_ceil(super::learn::CHUNK);
        Ok(Self {
            plan,
            parameters: RwLock::new(learnt.parameters.clone()),
            scales: RwLock::new(None),
            pieces: pieces.into_iter().map(Mutex::new).collect(),
            rollout: RwLock::new(RolloutBuffer::new(
                settings.n_envs * settings.n_steps,
                shape.observation,
                shape.action,
            )),
            minibatches: RwLock::default(),
            chunks: (0..chunks).map(|_| Mutex::new(Chunk::new(networks))).collect(),
        })
    }

    pub fn work(&self, phase: Phase, item: usize) {
        let networks = &self.plan.networks;
        let parameters = self.parameters.read();
        match phase {
            Phase::Learn { weights } => {
                let (rollout, minibatches) = (self.rollout.read(), self.minibatches.read());
                self.chunks[item].lock().learn(networks, &parameters, &rollout, &minibatches, item, &weights);
            }
            Phase::Act { .. } | Phase::Finish => {
                let scales = self.scales.read();
                let play = self.plan.context(&parameters, scales.as_ref());
                let mut piece = self.pieces[item].lock();
                match phase {
                    Phase::Act { step } => piece.act(&play, step),
                    _ => piece.finish(&play),
                }
            }
        }
    }
}
