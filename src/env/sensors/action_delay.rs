//! The time from an action to the motors.

use super::memory::shift;
use super::random::stream;
use rand::Rng as _;

/// In place of a step's number, this selects the random numbers for the delay. The sensors' draws use the step's number, counted from 0.
const DRAW: u64 = u64::MAX;

/// The delay of an episode's actions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActionDelay {
    /// Number of whole control steps in the delay; the next field is the number of remaining time steps.
    steps: usize,
    substeps: usize,
    /// Actions of the last control steps: the newest first; empty if no action is ever late.
    actions: Vec<f32>,
    width: usize,
}

impl ActionDelay {
    /// Draws the delay of an episode from `range` [s]. Actions before the first one are 0.
    pub fn draw([low, high]: [f64; 2], [seed, number]: [u64; 2], width: usize, [period, dt]: [f64; 2]) -> Self {
        if high == 0.0 {
            return Self::default();
        }
        let delay = low + (high - low) * stream(seed, number, DRAW).random::<f64>();
        let all = (delay / dt).round() as usize;
        let whole = (period / dt).round() as usize;
        let kept = (high / period).ceil() as usize + 2;
        Self { steps: all / whole, substeps: all % whole, actions: vec![0.0; kept * width], width }
    }

    pub fn is_none(&self) -> bool {
        self.actions.is_empty()
    }

    /// Adds the action of this control step.
    pub fn push(&mut self, action: &[f32]) {
        shift(&mut self.actions, self.width);
        self.actions[..self.width].copy_from_slice(action);
    }

    /// The action that the motors follow at the start of this control step.
    pub fn first(&self) -> &[f32] {
        self.at(self.steps + usize::from(self.substeps > 0))
    }

    /// The action that arrives within this control step, and the time step at which it arrives; None: the motors follow
    /// the first action during the whole control step.
    pub fn second(&self) -> Option<(usize, &[f32])> {
        (self.substeps > 0).then(|| (self.substeps, self.at(self.steps)))
    }

    fn at(&self, back: usize) -> &[f32] {
        &self.actions[back * self.width..][..self.width]
    }

    /// The actions, for a snapshot.
    pub fn numbers(&self) -> &[f32] {
        &self.actions
    }

    /// The same delay with these actions; None if their number is wrong or one is not within ±1.
    pub fn resume(mut self, actions: &[f32]) -> Option<Self> {
        let sound = actions.len() == self.actions.len() && actions.iter().all(|a| (-1.0..=1.0).contains(a));
        self.actions.copy_from_slice(if sound { actions } else { return None });
        Some(self)
    }
}
