//! Logs for tests: the hexapod walks with servos in engine `rapier`, which is not the engine that replays the logs, and its sensors have errors.

use super::replay::{LoggedMotion, Replay, Signals, sample};
use crate::sand::mechanism::Mechanisms;
use crate::sand::{Coefficients, Medium};
use crate::series::interpolate;
use crate::sim::engine::EngineKind;
use crate::sim::model::Scene;
use crate::sim::walk::{WalkTrial, Watch, walk_watched};
use crate::sim::{Model, Robot, State};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::f64::consts::TAU;
use std::fmt::Write;

/// Properties of a generated log that the experiment file does not state.
#[derive(Clone)]
pub struct Truth {
    pub mechanisms: Mechanisms,
    /// Rotation of the IMU from its stated mounting, in its own frame [rad].
    pub turn: [f64; 3],
    /// Delay of the IMU [s].
    pub delay: f64,
    /// Time constant of the IMU's first-order filter [s].
    pub low_pass: f64,
    /// Mass of the base, as a multiple of the robot file's.
    pub mass: f64,
    /// Ratio of the motors' torque to the torque that their drives compute.
    pub drive: f64,
    pub seed: u64,
}

impl Truth {
    pub fn new(mechanisms: Mechanisms, seed: u64) -> Self {
        Self { mechanisms, turn: [0.02, -0.015, 0.02], delay: 0.004, low_pass: 0.0, mass: 1.0, drive: 1.0, seed }
    }
}

/// Leg, stride frequency [Hz] and slope [°] of each run.
pub const RUNS: [(&str, f64, f64); 5] =
    [("L", 1.5, 0.0), ("L", 3.0, 5.0), ("revL", 2.0, 0.0), ("revL", 3.5, 5.0), ("L", 2.0, 0.0)];
/// Length of each run [s].
const LENGTH: f64 = 2.7;
pub const EXPERIMENT: &str = "kind = \"trajectory\"\nrobot = \"xplorer\"\nmedium = \"poppy-loose\"\nbulk_density = 638.0\n\
    coefficient_sd = 0.05\n[imu]\nposition = [0.01, 0.0, 0.0]\n";

pub fn experiment() -> crate::experiment::Experiment {
    crate::experiment::Experiment::from_toml(EXPERIMENT).unwrap()
}

pub fn csv(truth: &Truth) -> String {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(truth.seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
    let robot = Robot::built_in("xplorer").unwrap();
    let joints = robot.joint_names();
    let mut text = String::from("run,condition,leg,slope_deg,stride_frequency,t");
    for kind in ["q", "qd", "tau"] {
        joints.iter().for_each(|j| write!(text, ",{kind}:{j}").unwrap());
    }
    text += ",gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z\n";
    let mut medium = Medium::named("poppy-loose").unwrap();
    // Coefficients and strengths of beds scatter about the nominal values. Their mean strength does not change, because it is a part of the truth.
    let nominal = medium.coefficients.to_array();
    let drawn = nominal.map(|c| c * (1.0 + 0.05 * normal()));
    let size = |all: [f64; 9]| all.iter().map(|c| c.abs()).sum::<f64>();
    medium.coefficients = Coefficients::from_array(drawn.map(|c| c * size(nominal) / size(drawn)));
    let beds = RUNS.map(|_| 1.0 + 0.03 * normal());
    let mean = beds.iter().sum::<f64>() / beds.len() as f64;
    for (k, (leg, frequency, slope_deg)) in RUNS.into_iter().enumerate() {
        let mut robot = robot.clone().with_leg_shape(leg).unwrap();
        robot.base.mass *= truth.mass;
        robot.servo.kp *= truth.drive;
        robot.servo.kd *= truth.drive;
        let mut scene = Scene::flat(medium.clone());
        (scene.slope_deg, scene.dt) = (slope_deg, 5e-4);
        let bed = beds[k] / mean;
        scene.mechanisms = Mechanisms { scale: (1.0 + truth.mechanisms.scale) * bed - 1.0, ..truth.mechanisms };
        let phase = 0.1 * normal().clamp(-2.0, 2.0);
        let model = Model::new(&robot, &scene).unwrap();
        let trial = WalkTrial { phase, strides: (LENGTH - 0.5) * frequency - 2.0, ..WalkTrial::new(model, frequency) };
        rows(&mut text, truth, &trial, (k, leg, slope_deg, frequency), &mut normal);
    }
    text
}

/// Writes the sensors' readings of one run, one row every 5 ms.
fn rows(
    text: &mut String,
    truth: &Truth,
    trial: &WalkTrial,
    (run, leg, slope_deg, frequency): (usize, &str, f64, f64),
    normal: &mut impl FnMut() -> f64,
) {
    let mut states: Vec<State> = Vec::new();
    let mut watch = Watch { rate: 1000.0, see: &mut |_, state| states.push(state.clone()) };
    walk_watched(EngineKind::Rapier, trial, &|_| Ok(()), &mut watch).unwrap();
    let joints = trial.model.joints();
    let imu = [0.01, 0.0, 0.0];
    let (model, drive) = (&trial.model, LoggedMotion::held(&vec![0.0; joints], 0, 1e-3));
    let mut track = Signals::empty(joints, states.len(), model.scene.dt);
    let task = Replay { model, drive: &drive, imu };
    states.windows(2).for_each(|s| sample(&task, &s[0], &s[1], &mut track));
    track.signals[joints..].iter_mut().for_each(|signal| filter(signal, truth.low_pass));
    let turn = nalgebra::Rotation3::from_scaled_axis(nalgebra::Vector3::from(truth.turn)).inverse();
    let offsets: Vec<f64> = (0..joints).map(|_| 2e-4 * normal()).collect();
    let biases: Vec<f64> = (0..6).map(|k| if k < 3 { 0.02 } else { 0.05 } * normal()).collect();
    let times: Vec<f64> = (1..states.len()).map(|k| 1e-3 * k as f64).collect();
    // The engine wraps angles to one turn; in a log they keep increasing.
    let mut angles = states[0].angles.clone();
    for i in (0..states.len() - 1).step_by(5) {
        let state = &states[i];
        write!(text, "{run},{leg}{frequency},{leg},{slope_deg},{frequency},{:.3}", 1e-3 * i as f64).unwrap();
        let step = TAU / 4096.0;
        for (angle, now) in angles.iter_mut().zip(&state.angles) {
            let change = now - *angle;
            *angle += change - TAU * (change / TAU).round();
            write!(text, ",{:.5}", (*angle / step).round() * step).unwrap();
        }
        state.rates.iter().for_each(|q| write!(text, ",{:.3}", q + 0.05 * normal()).unwrap());
        for (tau, offset) in state.torques.iter().zip(&offsets) {
            write!(text, ",{:.5}", tau / truth.drive * (1.0 + 0.02 * normal()) + offset).unwrap();
        }
        let read = |signal: usize| {
            // Sample k of the track belongs to the end of tick k, at (k + 1) ms.
            let at = 1e-3 * i as f64 - truth.delay + track.lag(joints + signal, joints, 1e-3);
            let near = (-2..=2).map(|k| 1e-3 * f64::from(k) + at);
            near.map(|t| interpolate(&times, &track.signals[joints + signal], t)).sum::<f64>() / 5.0
        };
        let own = |first: usize| turn * nalgebra::Vector3::from_fn(|k, _| read(first + k));
        let (gyro, acc) = (own(0), own(3));
        for (k, value) in gyro.iter().chain(acc.iter()).enumerate() {
            let noise = if k < 3 { 0.01 } else { 0.05 };
            write!(text, ",{:.4}", value + biases[k] + noise * normal()).unwrap();
        }
        text.push('\n');
    }
}

/// A first-order filter in small steps, for samples every millisecond.
fn filter(signal: &mut [f64], time: f64) {
    const PARTS: u32 = 50;
    let (mut value, mut before) = (signal[0], signal[0]);
    for x in signal.iter_mut().filter(|_| time > 0.0) {
        for k in 0..PARTS {
            let input = before + (*x - before) * (f64::from(k) + 0.5) / f64::from(PARTS);
            value += (input - value) * 1e-3 / f64::from(PARTS) / time;
        }
        before = std::mem::replace(x, value);
    }
}

pub fn file(text: impl AsRef<[u8]>) -> tempfile::NamedTempFile {
    let file = tempfile::Builder::new().suffix(".csv").tempfile().unwrap();
    std::fs::write(file.path(), text).unwrap();
    file
}
