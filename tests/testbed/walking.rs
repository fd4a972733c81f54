//! Simulated measurements of walking: runs with a hidden cause, by another engine than the forward model's.
//!
//! The engine is rapier, with a smaller time step and finer legs. Every run has its own bed strength and initial phase.

use super::normal;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::parallel;
use sandgait::sand::{Coefficients, Mechanisms, Medium};
use sandgait::sim::engine::EngineKind;
use sandgait::sim::model::Scene;
use sandgait::sim::walk::{WalkResult, WalkTrial, walk};
use sandgait::sim::{Model, Robot};
use std::fmt::Write;

pub const EXPERIMENT: &str =
    "kind = \"walking\"\nmedium = \"poppy-loose\"\nbulk_density = 638.0\ncoefficient_sd = 0.08\nrobot = \"xplorer\"\n";

/// Relative sd of the bed's strength from run to run, and of each measured number.
const STRENGTH: f64 = 0.05;
const SCATTER: f64 = 0.025;
/// Half the range of the initial phase [rad].
const PHASE: f64 = 0.2;
const STEP: f64 = 2.5e-4;
const SEGMENTS: usize = 17;
const REPETITIONS: usize = 3;

/// One condition of the runs.
#[derive(Clone, Copy, Debug)]
pub struct Condition {
    pub leg: &'static str,
    /// Stride frequency [Hz].
    pub frequency: f64,
    pub slope_deg: f64,
    /// Payload [kg].
    pub payload: f64,
    /// Position in the bed at which the run begins [m].
    pub x_bed: f64,
}

/// Both leg shapes at three frequencies, uphill, and with a payload.
pub fn orderly() -> Vec<Condition> {
    let rows = [
        (2.0, 0.0, 0.0, 0.2),
        (3.0, 0.0, 0.0, -0.2),
        (4.0, 0.0, 0.0, 0.0),
        (3.0, 5.0, 0.0, 0.1),
        (2.5, 0.0, 0.03, -0.1),
    ];
    let of = |leg| {
        rows.map(|(frequency, slope_deg, payload, x_bed)| Condition { leg, frequency, slope_deg, payload, x_bed })
    };
    ["L", "revL"].map(of).concat()
}

/// The same number of conditions, drawn at random.
pub fn drawn(seed: u64) -> Vec<Condition> {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed ^ 0xde51);
    let mut condition = |leg| Condition {
        leg,
        frequency: [1.5, 2.0, 2.5, 3.0, 4.0][rng.random_range(0..5)],
        slope_deg: [0.0, 0.0, 5.0, -5.0][rng.random_range(0..4)],
        payload: [0.0, 0.0, 0.03][rng.random_range(0..3)],
        x_bed: rng.random_range(-0.2..0.2),
    };
    ["L", "L", "L", "L", "L", "revL", "revL", "revL", "revL", "C"].map(&mut condition).to_vec()
}

/// The runs as CSV.
pub fn runs(seed: u64, conditions: &[Condition], hidden: Mechanisms, coefficient_error: f64) -> String {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut medium = Medium::named("poppy-loose").unwrap();
    medium.bulk_density = 638.0;
    let coefficients = medium.coefficients.to_array().map(|c| c * (1.0 + coefficient_error * normal(&mut rng)));
    medium.coefficients = Coefficients::from_array(coefficients);
    let mut trials = Vec::new();
    for c in conditions {
        let mut robot = Robot::load("xplorer").unwrap().with_leg_shape(c.leg).unwrap();
        robot.leg.link[0].sand.as_mut().unwrap().segments = SEGMENTS;
        for _ in 0..REPETITIONS {
            let mut scene = Scene::flat(medium.clone());
            (scene.mechanisms, scene.slope_deg, scene.payload, scene.dt) = (hidden, c.slope_deg, c.payload, STEP);
            scene.mechanisms.scale = (1.0 + hidden.scale) * (1.0 + STRENGTH * normal(&mut rng)) - 1.0;
            let trial = WalkTrial::new(Model::new(&robot, &scene).unwrap(), c.frequency);
            trials.push(WalkTrial { x_bed: c.x_bed, phase: rng.random_range(-PHASE..PHASE), ..trial });
        }
    }
    let walked = parallel::map(&trials, |t| walk(EngineKind::Rapier, t).unwrap());
    csv(conditions, &walked, &mut rng)
}

fn csv(conditions: &[Condition], walked: &[WalkResult], rng: &mut Xoshiro256PlusPlus) -> String {
    let mut text =
        "run,condition,rep,robot,leg,xi_deg,stride_frequency,slope_deg,payload,x_bed,duration,speed,base_height,\
                    pitch_rms,hip_torque_rms,hip_speed_error_rms\n"
            .to_string();
    for (k, w) in walked.iter().enumerate() {
        let (condition, rep) = (k / REPETITIONS, k % REPETITIONS);
        let Condition { leg, frequency, slope_deg: slope, payload, x_bed } = conditions[condition];
        let xi = match leg {
            "L" => "45",
            "revL" => "-45",
            _ => "",
        };
        let duration = 4.0 / frequency;
        let _ = write!(
            text,
            "{condition}_{rep},{condition},{rep},xplorer,{leg},{xi},{frequency},{slope},{payload},{x_bed},{duration}"
        );
        for value in [w.speed, w.base_height, w.pitch_rms, w.hip_torque_rms, w.hip_speed_error_rms] {
            let _ = write!(text, ",{:.6e}", value * (1.0 + SCATTER * normal(rng)));
        }
        text.push('\n');
    }
    text
}
