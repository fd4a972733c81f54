//! A hall of our own: walking runs with a hidden cause, made apart from the forward model.
//!
//! The other engine (rapier), a finer time step, finer legs, and for every run its own bed strength and initial phase.

use super::normal;
use rand::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sandgait::parallel;
use sandgait::sand::{Coefficients, Mechanisms, Medium};
use sandgait::sim::engine::EngineKind;
use sandgait::sim::model::Scene;
use sandgait::sim::walk::{Trial, WalkResult, walk};
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

/// Leg, frequency [Hz], slope [°], payload [kg], start in the bed [m].
const CONDITIONS: [(&str, f64, f64, f64, f64); 10] = [
    ("L", 2.0, 0.0, 0.0, 0.2),
    ("L", 3.0, 0.0, 0.0, -0.2),
    ("L", 4.0, 0.0, 0.0, 0.0),
    ("L", 3.0, 5.0, 0.0, 0.1),
    ("L", 2.5, 0.0, 0.03, -0.1),
    ("revL", 2.0, 0.0, 0.0, 0.2),
    ("revL", 3.0, 0.0, 0.0, -0.2),
    ("revL", 4.0, 0.0, 0.0, 0.0),
    ("revL", 3.0, 5.0, 0.0, 0.1),
    ("revL", 2.5, 0.0, 0.03, -0.1),
];

/// Runs as CSV.
pub fn runs(seed: u64, hidden: Mechanisms, coefficient_error: f64) -> String {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut medium = Medium::named("poppy-loose").unwrap();
    medium.bulk_density = 638.0;
    let coefficients = medium.coefficients.to_array().map(|c| c * (1.0 + coefficient_error * normal(&mut rng)));
    medium.coefficients = Coefficients::from_array(coefficients);
    let mut trials = Vec::new();
    for (leg, frequency, slope_deg, payload, x_bed) in CONDITIONS {
        let mut robot = Robot::load("xplorer").unwrap().with_leg_shape(leg).unwrap();
        robot.leg.link[0].sand.as_mut().unwrap().segments = SEGMENTS;
        for _ in 0..REPETITIONS {
            let mut scene = Scene::flat(medium.clone());
            (scene.mechanisms, scene.slope_deg, scene.payload, scene.dt) = (hidden, slope_deg, payload, STEP);
            scene.mechanisms.scale = (1.0 + hidden.scale) * (1.0 + STRENGTH * normal(&mut rng)) - 1.0;
            let trial = Trial::new(Model::new(&robot, &scene).unwrap(), frequency);
            trials.push(Trial { x_bed, phase: rng.random_range(-PHASE..PHASE), ..trial });
        }
    }
    let walked = parallel::map(&trials, |t| walk(EngineKind::Rapier, t).unwrap());
    csv(&walked, &mut rng)
}

fn csv(walked: &[WalkResult], rng: &mut Xoshiro256PlusPlus) -> String {
    let mut text =
        "run,condition,rep,robot,leg,xi_deg,stride_frequency,slope_deg,payload,x_bed,duration,speed,base_height,\
                    pitch_rms,hip_torque_rms,hip_speed_error_rms\n"
            .to_string();
    for (k, w) in walked.iter().enumerate() {
        let (condition, rep) = (k / REPETITIONS, k % REPETITIONS);
        let (leg, frequency, slope, payload, x_bed) = CONDITIONS[condition];
        let xi = if leg == "L" { 45.0 } else { -45.0 };
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
