//! The learnt policy as one network that includes normalization and mirror.

use super::network::NetworkLayer;
use super::normal::{CLIP, EPSILON};
use super::plan::{TrainingPlan, TrainingState};
use crate::policy::write::OnnxWriter;

/// The policy without noise as the bytes of an ONNX file, from the environments' observations to actions.
pub fn onnx(plan: &TrainingPlan, learnt: &TrainingState) -> Vec<u8> {
    let shape = &plan.networks.shape;
    let mut file = OnnxWriter::new(shape.observation);
    let mut x = file.input();
    if let Some(normal) = &learnt.normal {
        // The mean is a sum of two f32, because one f32 is not precise enough for a number that hardly varies.
        let mean = &normal.observations.mean;
        let center: Vec<f32> = mean.iter().map(|m| *m as f32).collect();
        let rest: Vec<f32> = mean.iter().zip(&center).map(|(m, c)| (m - f64::from(*c)) as f32).collect();
        let variance = &normal.observations.variance;
        let scale: Vec<f32> = variance.iter().map(|v| (v + EPSILON).sqrt() as f32).collect();
        x = file.subtract(&x, &center);
        x = file.normalize(&x, &rest, &scale, CLIP);
    }
    let parameters = &learnt.parameters;
    let mut layers: Vec<[Vec<f32>; 2]> = shape.actor.iter().map(|layer| numbers(layer, parameters)).collect();
    let bounds: Vec<[f32; 2]> = plan.spec.action.iter().map(|c| [c.low as f32, c.high as f32]).collect();
    if plan.spec.blueprint.is_none() {
        // Scales the output from ±1 to the ends of the action space.
        let [weights, bias] = &mut layers[shape.actor.len() - 1];
        for row in weights.chunks_exact_mut(shape.action).chain([&mut bias[..]]) {
            row.iter_mut().zip(&bounds).for_each(|(w, [low, high])| *w *= 0.5 * (high - low));
        }
        bias.iter_mut().zip(&bounds).for_each(|(b, [low, high])| *b += 0.5 * (low + high));
    }
    let action = match &plan.networks.mirror {
        None => through(&mut file, &x, &layers),
        // The mirrors only permute columns and change signs, so they can be included in the outer layers' weights
        // without rounding.
        Some([observation, action]) => {
            let last = layers.len() - 1;
            let (mut own, mut image) = (layers.clone(), layers.clone());
            let [weights, _] = &mut image[0];
            let width = shape.actor[0].outputs;
            for (k, (from, sign)) in observation.order.iter().zip(&observation.signs).enumerate() {
                // Input k of the mirror image is `sign` times number `from` of the row. So the image's weights of
                // number `from` are `sign` times the weights of input k.
                let row = layers[0][0][k * width..(k + 1) * width].iter().map(|w| sign * w);
                weights[from * width..(from + 1) * width].iter_mut().zip(row).for_each(|(out, w)| *out = w);
            }
            let (source, width) = (image[last].clone(), shape.action);
            for (out, before) in image[last].iter_mut().zip(&source) {
                let rows = out.chunks_exact_mut(width).zip(before.chunks_exact(width));
                rows.for_each(|(out, before)| action.reflect(before, out));
            }
            let halves = own[last].iter_mut().chain(image[last].iter_mut()).flatten();
            halves.for_each(|w| *w *= 0.5);
            let (own, image) = (through(&mut file, &x, &own), through(&mut file, &x, &image));
            file.add(&own, &image)
        }
    };
    let action = file.clip_row(&action, &bounds);
    file.finish(&action, shape.action)
}

/// Weights and bias.
fn numbers(layer: &NetworkLayer, parameters: &[f32]) -> [Vec<f32>; 2] {
    [&layer.weights, &layer.bias].map(|place| parameters[place.clone()].to_vec())
}

fn through(file: &mut OnnxWriter, x: &str, layers: &[[Vec<f32>; 2]]) -> String {
    let mut x = x.to_owned();
    for (k, [weights, bias]) in layers.iter().enumerate() {
        if k > 0 {
            x = file.tanh(&x);
        }
        x = file.dense(&x, weights, bias);
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Hyperparameters;
    use crate::env::registry::Blueprint;
    use crate::network::Networks;
    use crate::policy::Network;
    use serde_json::{Value, json};

    /// The file's actions equal the actions of the learnt networks, with and without mirror and normalization.
    #[test]
    fn the_file_acts_as_the_networks_do() {
        for (mirror, normalize, sizes) in [
            (true, true, json!([16, 8])),
            (false, true, json!([8])),
            (true, false, json!([])),
            (false, false, json!([5])),
        ] {
            let entry = json!({"mirror": mirror, "normalize": normalize, "policy_kwargs": {"net_arch": sizes}});
            let settings = Hyperparameters::from_entry(entry.as_object().unwrap()).unwrap();
            let blueprint = Blueprint::new("sandgait/HexapodGait-v1", Value::Null).unwrap();
            let plan = TrainingPlan::new(blueprint, settings, 3, 1).unwrap();
            let mut learnt = plan.begin();
            for (k, p) in learnt.parameters.iter_mut().enumerate() {
                *p += 0.1 * (k as f32 * 0.7).sin();
            }
            if let Some(normal) = &mut learnt.normal {
                for (k, (mean, variance)) in
                    normal.observations.mean.iter_mut().zip(&mut normal.observations.variance).enumerate()
                {
                    (*mean, *variance) = (0.1 * k as f64, 0.5 + k as f64);
                }
            }
            let spec = plan.spec.task().unwrap().task.spec();
            let Networks { shape, .. } = &plan.networks;
            let rows = 20;
            let observations: Vec<f32> = (0..rows * shape.observation).map(|k| 3.0 * (k as f32).sin()).collect();
            let mut actions = vec![0.0; rows * shape.action];
            Network::new(&onnx(&plan, &learnt), spec).unwrap().act(&observations, &mut actions).unwrap();
            let mut pass = plan.networks.pass(rows);
            plan.networks.forward(&learnt.parameters, &mut pass, rows, |out| match &learnt.normal {
                Some(normal) => normal.scales().observations(&observations, out),
                None => out.copy_from_slice(&observations),
            });
            for (action, mean) in actions.iter().zip(&pass.means) {
                assert!((action - mean.clamp(-1.0, 1.0)).abs() < 2e-5, "{action} {mean}, mirror {mirror}");
            }
            assert!(actions.iter().any(|a| a.abs() > 0.01));
        }
    }
}
