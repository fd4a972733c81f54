//! Generalised least squares: a linear map after which the noise is white.

use super::noise::{ChannelFilter, LANES, Noise, NoiseData};
use super::shared::LowRank;
use crate::parallel;
use std::borrow::Borrow;
use std::ops::Range;

#[derive(Clone)]
struct UnitFilter {
    span: Range<usize>,
    samples: usize,
    /// Whitenings of the channels, in the stack's order.
    channels: Vec<ChannelFilter>,
    shared: LowRank,
}

/// Whitens a stack of numbers unit by unit.
#[derive(Clone)]
pub struct Whitener {
    units: Vec<UnitFilter>,
    /// Factor on the whitened numbers of each unit.
    factors: Vec<f64>,
}

impl Whitener {
    /// The noise that a whole trial shares is proportional to the source's prediction. If this noise were proportional
    /// to the measured mean, the fitted `scale` would have an error (−12.6 % on data without a hidden cause).
    pub fn new(source: &NoiseData, noise: &Noise) -> Self {
        let repetitions = source.observations.repetitions();
        let units = source.observations.units.iter().zip(source.sizes).map(|(unit, sizes)| {
            let span = source.observations.span(unit);
            let steps = noise.clock.steps(&unit.progress);
            // The variance of an error that all n repetitions share is multiplied by n; see `share`.
            let repeated = repetitions[unit.condition].len() as f64;
            let own = |c: usize| -> Vec<f64> {
                let errors = source.uncertainty.own.get(unit.block(c)).unwrap_or_default();
                errors.iter().map(|e| repeated * e * e).collect()
            };
            let each = noise.channels.iter().zip(sizes).enumerate();
            let channels = each.map(|(c, (n, s))| ChannelFilter::new(n, s, &steps, &own(c))).collect();
            let mut filter = UnitFilter { span, samples: unit.samples, channels, shared: LowRank::new(Vec::new()) };
            filter.share(source, noise, repeated.sqrt());
            filter
        });
        let units: Vec<UnitFilter> = units.collect();
        Self { factors: vec![1.0; units.len()], units }
    }

    /// The whitener for a noise whose variance in each unit is divided by the unit's `weight`.
    pub fn weighted(&self, weight: impl Iterator<Item = f64>) -> Self {
        Self { units: self.units.clone(), factors: weight.map(f64::sqrt).collect() }
    }

    pub fn apply(&self, stack: &[f64]) -> Vec<f64> {
        let mut white = stack.to_vec();
        for (unit, factor) in self.units.iter().zip(&self.factors) {
            let own = &mut white[unit.span.clone()];
            unit.filter(own);
            unit.shared.apply(own);
            own.iter_mut().for_each(|value| *value *= factor);
        }
        white
    }

    /// The same for several stacks, which takes less time than one after the other.
    pub fn apply_all(&self, stacks: &[impl Borrow<Vec<f64>> + Sync]) -> Vec<Vec<f64>> {
        let some: Vec<_> = stacks.chunks(LANES).collect();
        parallel::map(&some, |some| self.together(some)).into_iter().flatten().collect()
    }

    fn together(&self, stacks: &[impl Borrow<Vec<f64>>]) -> Vec<Vec<f64>> {
        let mut white: Vec<Vec<f64>> = stacks.iter().map(|stack| stack.borrow().clone()).collect();
        let mut buffer = Vec::new();
        for (unit, factor) in self.units.iter().zip(&self.factors) {
            unit.filter_together(&mut white, &mut buffer);
            for white in &mut white {
                let own = &mut white[unit.span.clone()];
                unit.shared.apply(own);
                own.iter_mut().for_each(|value| *value *= factor);
            }
        }
        white
    }
}

impl UnitFilter {
    /// Filters one unit of several stacks.
    fn filter_together(&self, stacks: &mut [Vec<f64>], buffer: &mut Vec<[f64; LANES]>) {
        for (c, filter) in self.channels.iter().enumerate() {
            let from = self.span.start + c * self.samples;
            buffer.clear();
            buffer.resize(self.samples, [0.0; LANES]);
            for (lane, stack) in stacks.iter().enumerate() {
                let own = &stack[from..from + self.samples];
                buffer.iter_mut().zip(own).for_each(|(values, own)| values[lane] = *own);
            }
            filter.whiten_together(buffer);
            for (lane, stack) in stacks.iter_mut().enumerate() {
                let own = &mut stack[from..from + self.samples];
                own.iter_mut().zip(&*buffer).for_each(|(own, values)| *own = values[lane]);
            }
        }
    }

    fn filter(&self, own: &mut [f64]) {
        for (filter, values) in self.channels.iter().zip(own.chunks_mut(self.samples)) {
            filter.whiten(values);
        }
    }

    /// Adds the noise that all numbers of a repetition share. An error of the model, with variance e², is the same in
    /// all n repetitions of a condition, so the mean of the repetitions has the full variance e² and not e²/n. If each
    /// unit is whitened with the variance n e², the mean has this variance. The differences between repetitions then
    /// have too little weight, but they contain no information on causes.
    fn share(&mut self, source: &NoiseData, noise: &Noise, root_of_repetitions: f64) {
        let mut columns = Vec::new();
        for (shared, sd) in source.uncertainty.shared.iter().zip(&noise.shared) {
            for vector in shared.vectors(self.span.clone()) {
                let mut column: Vec<f64> = vector.iter().map(|v| sd * v).collect();
                self.filter(&mut column);
                columns.push(column);
            }
        }
        for stack in &source.uncertainty.common {
            let mut column: Vec<f64> = stack[self.span.clone()].iter().map(|e| root_of_repetitions * e).collect();
            self.filter(&mut column);
            columns.push(column);
        }
        self.shared = LowRank::new(columns);
    }
}

#[cfg(test)]
mod tests {
    use super::super::laws::tests::with_cohesion;

    /// Stacks that are whitened together are those that are whitened one by one.
    #[test]
    fn stacks_are_whitened_together_as_one_by_one() {
        with_cohesion(|study, fit| {
            let stacks = [&fit.slopes[..], &fit.slopes[..3]].concat();
            let one_by_one: Vec<Vec<f64>> = stacks.iter().map(|stack| study.whitener.apply(stack)).collect();
            assert_eq!(study.whitener.apply_all(&stacks), one_by_one);
        });
    }
}
