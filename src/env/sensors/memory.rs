//! What the sensors of an episode remember.

use super::signal::{Past, Senses};
use std::sync::Arc;

/// The sensors' part of an episode; empty for a task whose sensors are exact.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorMemory {
    /// The sensors that the episode has drawn; None: it uses the session's sensors.
    pub(super) senses: Option<Arc<Senses>>,
    pub(super) past: Vec<Past>,
    /// Rows as the sensors sampled them, before the delay; the newest first.
    pub(super) sampled: Vec<f32>,
    /// Rows that the policy got: the newest first.
    pub(super) seen: Vec<f32>,
}

impl SensorMemory {
    /// All numbers, for a snapshot.
    pub fn numbers(&self) -> Vec<f32> {
        let past = self.past.iter().flat_map(|p| [p.bias, p.filtered, p.exact]);
        past.chain(self.sampled.iter().copied()).chain(self.seen.iter().copied()).collect()
    }

    /// A memory of these sizes from its [`Self::numbers`]; None if their count is wrong or one is not finite.
    pub(super) fn from_numbers(numbers: &[f32], sizes: [usize; 3]) -> Option<Self> {
        let [signals, sampled, seen] = sizes;
        if numbers.len() != 3 * signals + sampled + seen || !numbers.iter().all(|x| x.is_finite()) {
            return None;
        }
        let (past, rows) = numbers.split_at(3 * signals);
        let (sampled, seen) = rows.split_at(sampled);
        let past = past.as_chunks::<3>().0.iter();
        let past = past.map(|[bias, filtered, exact]| Past { bias: *bias, filtered: *filtered, exact: *exact });
        Some(Self { senses: None, past: past.collect(), sampled: sampled.to_vec(), seen: seen.to_vec() })
    }
}

/// Makes room for a new row of `width` numbers at the front; the oldest row is lost.
pub(super) fn shift(rows: &mut [f32], width: usize) {
    let kept = rows.len() - width;
    rows.copy_within(..kept, width);
}
