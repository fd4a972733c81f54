//! Actor and critic: each has layers with hyperbolic tangents and then a linear layer. They share no layers, but all
//! parameters are in one array.
//!
//! The actor gives the mean of a normal distribution; the standard deviations are further parameters. With a mirror M,
//! actor f and critic v are averaged with their mirror images. For observation s they are (f(s) + M f(M s)) / 2 and
//! (v(s) + v(M s)) / 2.

use super::matrix::{AddBias, Matrix, SumRows, TanhGradient, multiply};
use super::mirror::Mirror;
use crate::number::Isa;
use rand::Rng;
use rand_distr::StandardNormal;
use std::ops::Range;

/// Indices of a layer's numbers in the parameters: weights f32 [inputs, outputs], then its bias.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkLayer {
    pub inputs: usize,
    pub outputs: usize,
    pub weights: Range<usize>,
    pub bias: Range<usize>,
}

/// Sizes of both networks.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkSizes {
    pub observation: usize,
    pub action: usize,
    pub actor: Vec<NetworkLayer>,
    pub critic: Vec<NetworkLayer>,
    /// Indices of the logarithms of the action's standard deviations in the array of parameters.
    pub log_std: Range<usize>,
    /// Number of parameters.
    pub parameters: usize,
}

impl NetworkSizes {
    /// `hidden`: sizes of the hidden layers, of the actor and of the critic.
    pub fn new(observation: usize, action: usize, hidden: &[Vec<usize>; 2]) -> Self {
        let mut parameters = 0;
        let mut take = |count: usize| {
            parameters += count;
            parameters - count..parameters
        };
        let mut stack = |hidden: &[usize], last: usize| {
            let mut inputs = observation;
            let layer = |outputs: &usize| {
                let (weights, bias) = (take(inputs * outputs), take(*outputs));
                NetworkLayer { inputs: std::mem::replace(&mut inputs, *outputs), outputs: *outputs, weights, bias }
            };
            hidden.iter().chain([&last]).map(layer).collect::<Vec<_>>()
        };
        let (actor, critic) = (stack(&hidden[0], action), stack(&hidden[1], 1));
        let log_std = take(action);
        Self { observation, action, actor, critic, log_std, parameters }
    }

    /// Initial parameters of stable-baselines3's PPO: orthogonal weights (Saxe et al. 2014), with a gain of √2 before a
    /// hyperbolic tangent, 0.01 for the action and 1 for the value; biases are 0.
    pub fn begin(&self, log_std: f32, random: &mut impl Rng) -> Vec<f32> {
        let mut parameters = vec![0.0; self.parameters];
        for (stack, last) in [(&self.actor, 0.01), (&self.critic, 1.0)] {
            for (k, layer) in stack.iter().enumerate() {
                let gain = if k + 1 == stack.len() { last } else { std::f64::consts::SQRT_2 };
                orthogonal(layer, gain, random, &mut parameters[layer.weights.clone()]);
            }
        }
        parameters[self.log_std.clone()].fill(log_std);
        parameters
    }
}

/// Fills `weights` so that its rows, or its columns if there are fewer, are orthogonal to each other and have
/// length `gain`.
fn orthogonal(layer: &NetworkLayer, gain: f64, random: &mut impl Rng, weights: &mut [f32]) {
    let (inputs, outputs) = (layer.inputs, layer.outputs);
    let (count, length) = (inputs.min(outputs), inputs.max(outputs));
    let mut vectors: Vec<Vec<f64>> = Vec::with_capacity(count);
    while vectors.len() < count {
        let mut v: Vec<f64> = (0..length).map(|_| random.sample(StandardNormal)).collect();
        // Done twice, because the second time removes the rounding errors of the first.
        for u in vectors.iter().chain(&vectors) {
            let along: f64 = u.iter().zip(&v).map(|(a, b)| a * b).sum();
            v.iter_mut().zip(u).for_each(|(v, u)| *v -= along * u);
        }
        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if norm > 1e-6 {
            v.iter_mut().for_each(|x| *x /= norm);
            vectors.push(v);
        }
    }
    for (k, weight) in weights.iter_mut().enumerate() {
        let (input, output) = (k / outputs, k % outputs);
        let x = if inputs < outputs { vectors[input][output] } else { vectors[output][input] };
        *weight = (gain * x) as f32;
    }
}

/// Work space for the outputs of a network's layers and their derivatives.
#[derive(Clone, Debug, Default)]
struct LayerStack {
    outputs: Vec<Vec<f32>>,
    slopes: Vec<Vec<f32>>,
}

impl LayerStack {
    fn new(layers: &[NetworkLayer], rows: usize) -> Self {
        let room: Vec<_> = layers.iter().map(|l| vec![0.0; rows * l.outputs]).collect();
        Self { slopes: room.clone(), outputs: room }
    }

    /// Computes the layers for `rows` rows of `inputs`.
    fn forward(&mut self, layers: &[NetworkLayer], parameters: &[f32], inputs: &[f32], rows: usize, isa: Isa) {
        for (k, layer) in layers.iter().enumerate() {
            let (before, rest) = self.outputs.split_at_mut(k);
            let input = before.last().map_or(inputs, |x| &x[..rows * layer.inputs]);
            let out = &mut rest[0][..rows * layer.outputs];
            let weights = Matrix::new(&parameters[layer.weights.clone()], layer.outputs);
            multiply(Matrix::new(input, layer.inputs), weights, false, out);
            let bias = &parameters[layer.bias.clone()];
            isa.run(AddBias { rows: out, bias, curved: k + 1 < layers.len() });
        }
    }

    /// Adds to `gradient` the contribution of the derivatives by the last layer's outputs.
    fn backward(
        &mut self,
        layers: &[NetworkLayer],
        parameters: &[f32],
        inputs: &[f32],
        rows: usize,
        isa: Isa,
        gradient: &mut [f32],
    ) {
        for (k, layer) in layers.iter().enumerate().rev() {
            let (before, rest) = self.slopes.split_at_mut(k);
            let slopes = &rest[0][..rows * layer.outputs];
            let input = if k == 0 { inputs } else { &self.outputs[k - 1][..rows * layer.inputs] };
            let slope = Matrix::new(slopes, layer.outputs);
            let out = &mut gradient[layer.weights.clone()];
            multiply(Matrix::new(input, layer.inputs).transposed(), slope, true, out);
            isa.run(SumRows { rows: slopes, sum: &mut gradient[layer.bias.clone()] });
            if let Some(earlier) = before.last_mut() {
                let earlier = &mut earlier[..rows * layer.inputs];
                let weights = Matrix::new(&parameters[layer.weights.clone()], layer.outputs);
                multiply(slope, weights.transposed(), false, earlier);
                isa.run(TanhGradient { slopes: earlier, outputs: input });
            }
        }
    }
}

/// Both networks, without their parameters.
#[derive(Clone, Debug)]
pub struct Networks {
    pub shape: NetworkSizes,
    /// The mirrors of observations and of actions.
    pub mirror: Option<[Mirror; 2]>,
    pub isa: Isa,
}

/// Work space for a number of rows in both networks.
pub struct NetworkPass {
    /// f32 [2 · rows, observation]; the second half is for mirror images.
    observations: Vec<f32>,
    actor: LayerStack,
    critic: LayerStack,
    rows: usize,
    /// f32 [rows, action]
    pub means: Vec<f32>,
    /// f32 [rows]
    pub values: Vec<f32>,
}

impl Networks {
    /// Room for at most `rows` rows.
    pub fn pass(&self, rows: usize) -> NetworkPass {
        let all = rows * self.images();
        NetworkPass {
            observations: vec![0.0; all * self.shape.observation],
            actor: LayerStack::new(&self.shape.actor, all),
            critic: LayerStack::new(&self.shape.critic, all),
            rows: 0,
            means: vec![0.0; rows * self.shape.action],
            values: vec![0.0; rows],
        }
    }

    /// Number of rows that the networks compute for each requested row.
    fn images(&self) -> usize {
        if self.mirror.is_some() { 2 } else { 1 }
    }

    /// Computes the means and values of `rows` rows of observations, which `fill` writes, f32 [rows, observation].
    pub fn forward(&self, parameters: &[f32], pass: &mut NetworkPass, rows: usize, fill: impl FnOnce(&mut [f32])) {
        let (wide, all) = (self.shape.observation, rows * self.images());
        pass.rows = rows;
        let observations = &mut pass.observations[..all * wide];
        let (own, images) = observations.split_at_mut(rows * wide);
        fill(own);
        if let Some([mirror, _]) = &self.mirror {
            mirror.reflect(own, images);
        }
        let observations = &*observations;
        pass.actor.forward(&self.shape.actor, parameters, observations, all, self.isa);
        pass.critic.forward(&self.shape.critic, parameters, observations, all, self.isa);
        let halves = |count: usize| [0..count, count..2 * count];
        let [means, mirrored] = halves(rows * self.shape.action);
        let [values, reflected] = halves(rows);
        let (actor, critic) = (last(&pass.actor.outputs), last(&pass.critic.outputs));
        match &self.mirror {
            None => {
                pass.means[..means.len()].copy_from_slice(&actor[means]);
                pass.values[..rows].copy_from_slice(&critic[values]);
            }
            Some([_, mirror]) => {
                let out = &mut pass.means[..means.len()];
                mirror.reflect(&actor[mirrored], out);
                out.iter_mut().zip(&actor[means]).for_each(|(out, own)| *out = 0.5 * (*out + own));
                let both = critic[values].iter().zip(&critic[reflected]);
                pass.values.iter_mut().zip(both).for_each(|(out, (a, b))| *out = 0.5 * (a + b));
            }
        }
    }

    /// Backpropagation through the last [`Networks::forward`]. `means` and `values` are the loss's derivatives by its means
    /// and values; the derivatives by the parameters are added to `gradient`.
    pub fn backward(
        &self,
        parameters: &[f32],
        pass: &mut NetworkPass,
        means: &[f32],
        values: &[f32],
        gradient: &mut [f32],
    ) {
        let (rows, all) = (pass.rows, pass.rows * self.images());
        let observations = &pass.observations[..all * self.shape.observation];
        let width = rows * self.shape.action;
        let actor = last_mut(&mut pass.actor.slopes);
        let critic = last_mut(&mut pass.critic.slopes);
        match &self.mirror {
            None => {
                actor[..width].copy_from_slice(&means[..width]);
                critic[..rows].copy_from_slice(&values[..rows]);
            }
            Some([_, mirror]) => {
                let (own, image) = actor[..2 * width].split_at_mut(width);
                own.iter_mut().zip(means).for_each(|(out, slope)| *out = 0.5 * slope);
                // A mirror is its own inverse, and its own transpose.
                mirror.reflect(own, image);
                let (own, image) = critic[..2 * rows].split_at_mut(rows);
                for ((own, image), slope) in own.iter_mut().zip(image).zip(values) {
                    (*own, *image) = (0.5 * slope, 0.5 * slope);
                }
            }
        }
        pass.actor.backward(&self.shape.actor, parameters, observations, all, self.isa, gradient);
        pass.critic.backward(&self.shape.critic, parameters, observations, all, self.isa, gradient);
    }
}

fn last(rows: &[Vec<f32>]) -> &[f32] {
    rows.last().map_or(&[], Vec::as_slice)
}

fn last_mut(rows: &mut [Vec<f32>]) -> &mut [f32] {
    rows.last_mut().map_or(&mut [], Vec::as_mut_slice)
}
