//! One optimizer step: clips the gradient's norm, then applies Adam (Kingma & Ba 2015, arXiv:1412.6980) as PyTorch
//! does.

use crate::number::{Isa, Kernel};

/// Adam's β₁ and β₂, the values of Kingma & Ba and PyTorch's defaults.
const BETAS: [f32; 2] = [0.9, 0.999];
/// Adam's ε, added to the root of the mean square; the value of stable-baselines3's PPO.
const EPSILON: f32 = 1e-5;

/// Running means of the gradient and of its square, number by number.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    pub first: Vec<f32>,
    pub second: Vec<f32>,
    pub steps: u64,
}

impl Adam {
    pub fn new(parameters: usize) -> Self {
        Self { first: vec![0.0; parameters], second: vec![0.0; parameters], steps: 0 }
    }

    /// Moves `parameters` against `gradient`, whose norm is clipped to `most`. Returns the norm before clipping; if
    /// it is not finite, nothing has moved.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], rate: f64, most: f64, isa: Isa) -> f64 {
        let norm = gradient.iter().map(|g| f64::from(g * g)).sum::<f64>().sqrt();
        if !norm.is_finite() {
            return norm;
        }
        self.steps += 1;
        let left = |beta: f32| 1.0 - f64::from(beta).powf(self.steps as f64);
        let kernel = AdamStep {
            parameters,
            gradient,
            first: &mut self.first,
            second: &mut self.second,
            shrink: (most / (norm + 1e-6)).min(1.0) as f32,
            rate: (rate / left(BETAS[0])) as f32,
            root: left(BETAS[1]).sqrt() as f32,
        };
        isa.run(kernel);
        norm
    }
}

struct AdamStep<'a> {
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
    shrink: f32,
    rate: f32,
    root: f32,
}

impl Kernel for AdamStep<'_> {
    #[inline(always)]
    fn run(self) {
        let moments = self.first.iter_mut().zip(self.second);
        for ((p, g), (m, v)) in self.parameters.iter_mut().zip(self.gradient).zip(moments) {
            let g = g * self.shrink;
            *m += (1.0 - BETAS[0]) * (g - *m);
            *v = BETAS[1] * *v + (1.0 - BETAS[1]) * g * g;
            *p -= self.rate * *m / (v.sqrt() / self.root + EPSILON);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// PyTorch 2.15: Adam(lr=0.01, eps=1e-5) after clip_grad_norm_(…, 0.5), gradients (3, −0.02, 0) and (−1, 0.4, 1e-4).
    #[test]
    fn two_steps_are_torch_s() {
        let (mut adam, mut parameters) = (Adam::new(3), vec![1.0, -2.0, 0.5]);
        let norm = adam.step(&mut parameters, &[3.0, -0.02, 0.0], 0.01, 0.5, Isa::Baseline);
        assert!((norm - 3.000_066_7).abs() < 1e-6);
        adam.step(&mut parameters, &[-1.0, 0.4, 1e-4], 0.01, 0.5, Isa::Baseline);
        for (got, wanted) in parameters.iter().zip(TORCH) {
            assert!((got - wanted).abs() < 1e-6, "{parameters:?}");
        }
    }
    const TORCH: [f32; 3] = [0.990_155_64, -1.997_349_4, 0.494_295_87];

    #[test]
    fn a_gradient_that_is_not_finite_moves_nothing() {
        let (mut adam, mut parameters) = (Adam::new(2), vec![1.0, 2.0]);
        assert!(adam.step(&mut parameters, &[f32::NAN, 1.0], 0.01, 0.5, Isa::Baseline).is_nan());
        assert_eq!((parameters, adam), (vec![1.0, 2.0], Adam::new(2)));
    }
}
