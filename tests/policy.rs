//! Policies as ONNX files: actions equal those of stable-baselines3, do not depend on the batch, and wrong files are
//! refused.
//!
//! `tests/data/policy_*.onnx` are untrained networks of PPO and SAC with VecNormalize, written by
//! `sandgait.export_onnx`; `policy_actions.json` has observations and the actions of `predict(deterministic=True)` for
//! them (stable-baselines3 2.9.2).

#[path = "grpc/mutate.rs"]
mod mutate;

use rand::{Rng as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::env::registry::Blueprint;
use sandgait::policy::Network;
use serde_json::Value;
use std::time::Instant;

const PPO: &[u8] = include_bytes!("data/policy_ppo.onnx");
const SAC: &[u8] = include_bytes!("data/policy_sac.onnx");
const OBSERVATION: usize = 41;
const ACTION: usize = 6;

fn blueprint() -> Blueprint {
    Blueprint::new(HexapodGait::ID, Value::Null).unwrap()
}

fn network(onnx: &[u8]) -> Result<Network, String> {
    Network::new(onnx, blueprint().task.spec()).map_err(|e| e.to_string())
}

fn act(network: &Network, observations: &[f32]) -> Vec<f32> {
    let mut actions = vec![0.0; observations.len() / OBSERVATION * ACTION];
    network.act(observations, &mut actions).unwrap();
    actions
}

fn rows(table: &Value) -> Vec<f32> {
    let row = |row: &Value| row.as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect::<Vec<_>>();
    table.as_array().unwrap().iter().flat_map(row).collect()
}

fn reference() -> Value {
    serde_json::from_str(include_str!("data/policy_actions.json")).unwrap()
}

#[test]
fn actions_are_those_of_stable_baselines3() {
    let reference = reference();
    let observations = rows(&reference["observations"]);
    for (name, onnx) in [("ppo", PPO), ("sac", SAC)] {
        let (got, expected) = (act(&network(onnx).unwrap(), &observations), rows(&reference[name]));
        assert_eq!(got.len(), expected.len());
        let worst = got.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        println!("{name}: actions differ by {worst:.1e} at most");
        assert!(worst < 1e-5, "{name}: {worst}");
        assert!(expected.iter().filter(|a| a.abs() < 0.99).count() > expected.len() / 3, "most are not clipped");
    }
}

/// An action depends only on its own observation, not on other rows or on the lane.
#[test]
fn an_actions_bits_do_not_depend_on_the_batch() {
    let observations = rows(&reference()["observations"]);
    for onnx in [PPO, SAC] {
        let network = network(onnx).unwrap();
        let alone: Vec<f32> = observations.chunks(OBSERVATION).flat_map(|row| act(&network, row)).collect();
        for shift in [0, 1, 7, 16, 19] {
            let mut shifted = vec![0.3; shift * OBSERVATION];
            shifted.extend(&observations);
            assert_eq!(act(&network, &shifted)[shift * ACTION..], alone, "shifted by {shift}");
        }
    }
}

#[test]
fn non_finite_values_are_named() {
    let network = network(PPO).unwrap();
    let mut observations = vec![0.1; 20 * OBSERVATION];
    observations[18 * OBSERVATION + 3] = f32::NAN;
    let error = network.act(&observations, &mut [0.0; 20 * ACTION]).unwrap_err().to_string();
    assert_eq!(error, "policy: action[18][0] is not a number");
}

#[test]
fn wrong_files_are_refused_in_one_line() {
    let refused = |onnx: &[u8], words: &[&str]| {
        let error = network(onnx).unwrap_err();
        assert!(error.starts_with("policy: ") && !error.contains('\n'), "{error}");
        words.iter().for_each(|word| assert!(error.contains(word), "{error:?} lacks {word:?}"));
    };
    refused(b"", &["no ONNX file"]);
    refused(b"hello, world", &["no ONNX file"]);
    refused(&vec![0; 5 << 20], &["5242880 bytes", "4 MiB"]);
    let replaced = |from: &str, to: &str| {
        let text: Vec<u8> = SAC
            .windows(from.len())
            .position(|w| w == from.as_bytes())
            .map_or(Vec::new(), |at| [&SAC[..at], to.as_bytes(), &SAC[at + from.len()..]].concat());
        assert!(!text.is_empty(), "{from} is not in the file");
        text
    };
    refused(&replaced("Relu", "LSTM"), &["\"LSTM\" is not supported", "Relu", "Tanh"]);
    refused(&SAC[..SAC.len() / 2], &["no ONNX file"]);
    let legs = Blueprint::new("sandgait/HexapodLegs-v1", Value::Null).unwrap();
    let error = Network::new(PPO, legs.task.spec()).unwrap_err().to_string();
    assert_eq!(error, "policy: its input \"observation\" has 41 numbers a row, this task has 83");
}

/// Randomly damaged files are refused or run, without a panic and in bounded time.
#[test]
fn damaged_files_are_refused_or_run() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(30);
    let spec = blueprint();
    let spec = spec.task.spec();
    let observations = vec![0.5; 3 * OBSERVATION];
    let (mut read, mut ran, mut slowest) = (0, 0, 0.0_f64);
    for k in 0..20_000 {
        let (one, other) = if k % 2 == 0 { (PPO, SAC) } else { (SAC, PPO) };
        // The structure of the network is near the beginning; the rest is mostly weights.
        let spoiled = if k % 4 < 2 {
            mutate::mutated(&mut random, one, other)
        } else {
            let (head, tail) = one.split_at(random.random_range(1..one.len().min(1500)));
            [mutate::mutated(&mut random, head, other), tail.to_vec()].concat()
        };
        let start = Instant::now();
        if let Ok(network) = Network::new(&spoiled, spec) {
            read += 1;
            ran += usize::from(network.act(&observations, &mut [0.0; 3 * ACTION]).is_ok());
        }
        slowest = slowest.max(start.elapsed().as_secs_f64());
    }
    println!("of 20000 spoiled files {read} could be read and {ran} ran; the slowest took {slowest:.3} s");
    assert!(read > 500 && read < 19_000, "{read}");
    assert!(slowest < 5.0, "{slowest}");
}
