//! Compares the gradient of the loss with finite differences of the loss, which is implemented a second time here, in
//! `f64`.

use super::learn::{CHUNK, Chunk, Minibatches, RolloutBuffer};
use super::loss::LossWeights;
use super::mirror::Mirror;
use super::network::{NetworkLayer, NetworkSizes, Networks};
use crate::number::Isa;
use rand::SeedableRng as _;
use rand_xoshiro::Xoshiro256PlusPlus;

/// Sizes of a row: our choice, small, and different, so that exchanged indices are found.
const OBSERVATION: usize = 4;
const ACTION: usize = 3;

fn through(layers: &[NetworkLayer], p: &[f64], mut x: Vec<f64>) -> Vec<f64> {
    for (k, layer) in layers.iter().enumerate() {
        let (w, b) = (&p[layer.weights.clone()], &p[layer.bias.clone()]);
        let out = |j: usize| b[j] + (0..layer.inputs).map(|i| x[i] * w[i * layer.outputs + j]).sum::<f64>();
        x = (0..layer.outputs).map(out).collect();
        if k + 1 < layers.len() {
            x.iter_mut().for_each(|x| *x = x.tanh());
        }
    }
    x
}

fn reflect(mirror: &Mirror, x: &[f64]) -> Vec<f64> {
    mirror.order.iter().zip(&mirror.signs).map(|(from, sign)| f64::from(*sign) * x[*from]).collect()
}

fn outputs(networks: &Networks, p: &[f64], x: &[f64]) -> (Vec<f64>, f64) {
    let NetworkSizes { actor, critic, .. } = &networks.shape;
    let (own, value) = (through(actor, p, x.to_vec()), through(critic, p, x.to_vec())[0]);
    let Some([seen, done]) = &networks.mirror else { return (own, value) };
    let image = reflect(seen, x);
    let other = reflect(done, &through(actor, p, image.clone()));
    let means = own.iter().zip(other).map(|(a, b)| 0.5 * (a + b)).collect();
    (means, 0.5 * (value + through(critic, p, image)[0]))
}

/// stable-baselines3's loss, line by line of `PPO.train`, without the entropy.
fn loss(networks: &Networks, p: &[f64], rollout: &RolloutBuffer, advantages: &[f64], weights: &LossWeights) -> f64 {
    let n = advantages.len();
    let (mut policy, mut value) = (0.0, 0.0);
    for i in 0..n {
        let row = |x: &[f32], width: usize| -> Vec<f64> {
            x[i * width..(i + 1) * width].iter().map(|x| f64::from(*x)).collect()
        };
        let (means, predicted) = outputs(networks, p, &row(&rollout.observations, OBSERVATION));
        let log_std = &p[networks.shape.log_std.clone()];
        let action = row(&rollout.actions, ACTION);
        let density = action
            .iter()
            .zip(&means)
            .zip(log_std)
            .map(|((a, m), s)| -(a - m) * (a - m) / (2.0 * (2.0 * s).exp()) - s - 0.5 * std::f64::consts::TAU.ln());
        let ratio = (density.sum::<f64>() - f64::from(rollout.log_probabilities[i])).exp();
        let clip = f64::from(weights.clip);
        policy -= (advantages[i] * ratio).min(advantages[i] * ratio.clamp(1.0 - clip, 1.0 + clip));
        let old = f64::from(rollout.values[i]);
        let predicted = weights
            .clip_value
            .map_or(predicted, |clip| old + (predicted - old).clamp(-f64::from(clip), f64::from(clip)));
        value += (f64::from(rollout.returns[i]) - predicted).powi(2);
    }
    (policy + f64::from(weights.value) * value) / n as f64
}

fn networks(mirrored: bool) -> Networks {
    let mirror = [
        Mirror { order: vec![1, 0, 2, 3], signs: vec![1.0, 1.0, -1.0, 1.0] },
        Mirror { order: vec![1, 0, 2], signs: vec![-1.0, -1.0, 1.0] },
    ];
    let shape = NetworkSizes::new(OBSERVATION, ACTION, &[vec![7, 5], vec![6]]);
    Networks { shape, mirror: mirrored.then_some(mirror), isa: Isa::choose().unwrap() }
}

/// Samples whose ratios and values lie on both sides of the clipping.
fn rollout(rows: usize) -> RolloutBuffer {
    let mut rollout = RolloutBuffer::new(rows, OBSERVATION, ACTION);
    let wave = |x: &mut Vec<f32>, size: f32, pitch: f32, shift: f32| {
        x.iter_mut().enumerate().for_each(|(k, x)| *x = size * (pitch * k as f32).sin() + shift);
    };
    wave(&mut rollout.observations, 1.5, 0.37, 0.1);
    wave(&mut rollout.actions, 1.2, 0.71, 0.0);
    wave(&mut rollout.log_probabilities, 0.4, 1.9, -2.6);
    wave(&mut rollout.values, 0.5, 0.53, 0.0);
    wave(&mut rollout.advantages, 2.0, 0.91, 0.3);
    wave(&mut rollout.returns, 1.0, 0.77, 0.2);
    rollout
}

/// Gradient of the mean over all rows, computed by minibatches and chunks.
fn gradient(networks: &Networks, p: &[f32], rollout: &RolloutBuffer, weights: &LossWeights) -> Vec<f32> {
    let rows = rollout.returns.len();
    let mut minibatches = Minibatches::default();
    minibatches.shuffle(rows, &mut Xoshiro256PlusPlus::seed_from_u64(1));
    assert_eq!(minibatches.take(rollout, 0, rows, true), rows);
    let mut all = vec![0.0; p.len()];
    let mut chunk = Chunk::new(networks);
    for index in 0..minibatches.chunks() {
        chunk.learn(networks, p, rollout, &minibatches, index, weights);
        all.iter_mut().zip(&chunk.gradient).for_each(|(sum, g)| *sum += g);
    }
    all
}

#[test]
fn the_gradient_is_the_slope_of_the_loss() {
    let rows = 2 * CHUNK - 50;
    let rollout = rollout(rows);
    let n = rows as f64;
    let mean = rollout.advantages.iter().map(|a| f64::from(*a)).sum::<f64>() / n;
    let variance = rollout.advantages.iter().map(|a| (f64::from(*a) - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let advantages: Vec<f64> =
        rollout.advantages.iter().map(|a| (f64::from(*a) - mean) / (variance.sqrt() + 1e-8)).collect();
    for mirrored in [false, true] {
        for clip_value in [None, Some(0.3)] {
            let networks = networks(mirrored);
            let weights = LossWeights { clip: 0.2, clip_value, value: 0.5, imitates: false, samples: rows };
            let mut p = networks.shape.begin(-0.2, &mut Xoshiro256PlusPlus::seed_from_u64(2));
            p.iter_mut().enumerate().for_each(|(k, p)| *p += 0.2 * (k as f32 * 1.1).cos());
            let got = gradient(&networks, &p, &rollout, &weights);
            let exact: Vec<f64> = p.iter().map(|p| f64::from(*p)).collect();
            let largest = got.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
            for k in 0..p.len() {
                // The step is so small that hardly any sample crosses the limit of the clipping.
                let moved = |by: f64| {
                    let mut p = exact.clone();
                    p[k] += by;
                    loss(&networks, &p, &rollout, &advantages, &weights)
                };
                let slope = (moved(1e-7) - moved(-1e-7)) / 2e-7;
                let error = (f64::from(got[k]) - slope).abs() / f64::from(largest);
                assert!(error < 2e-5, "parameter {k} of {}, mirrored {mirrored}: {} {slope}", p.len(), got[k]);
            }
        }
    }
}
