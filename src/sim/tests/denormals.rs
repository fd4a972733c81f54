//! Counts denormal numbers in the processor while the engine runs without [`sandgait_number::flushed`]. So the test
//! finds a new constant that should be zero on every x86-64 processor, also on one where denormal numbers cost no time.

use crate::long;
use sandgait_number::Isa;
use sandgait_number::met_denormals;
use sandgait_sand::Medium;
use sandgait_sim::Robot;
use sandgait_sim::command::Command;
use sandgait_sim::engine::Integrator as _;
use sandgait_sim::lanes;
use sandgait_sim::model::Scene;
use sandgait_sim::{Model, State};

const FORMS: [(&str, &str); 7] = [
    ("xplorer", "L"),
    ("xplorer18", "flat"),
    ("xplorer", "revL"),
    ("xplorer", "C"),
    ("xplorer", "revC"),
    ("xplorer", "flat"),
    ("xplorer18", "L"),
];

fn model(robot: &str, leg: &str, slope_deg: f64) -> Model {
    let robot = Robot::built_in(robot).unwrap().with_leg_shape(leg).unwrap();
    let scene = Scene { slope_deg, ..Scene::flat(Medium::named("poppy-loose").unwrap()) };
    Model::new(&robot, &scene).unwrap()
}

/// Share of the control steps of 0.04 s, of 40 time steps each, in which the robot meets a denormal operand, with hips
/// that turn at `rate(time, joint)` [rad/s].
fn share(model: &Model, start: &State, time: f64, rate: impl Fn(f64, usize) -> f64) -> f64 {
    let mut engine = lanes::engine(Isa::choose().unwrap(), model, 1).unwrap();
    engine.set_state(0, start);
    let steps = (time / 0.04) as usize;
    let mut met = 0;
    for step in 0..steps {
        let rates = (0..model.joints()).map(|j| rate(step as f64 * 0.04, j)).collect();
        engine.command(0, &Command { rates, torques: vec![0.0; model.joints()], targets: vec![] });
        met += usize::from(met_denormals(|| engine.advance(40)));
    }
    met as f64 / steps as f64
}

/// A constant that is denormal, or makes denormal products, appears in every step. Values that pass through zero are
/// denormal now and then: in our runs in at most 6 % of the control steps.
#[test]
fn robots_that_move_meet_hardly_any() {
    for (robot, leg) in FORMS {
        for slope in [0.0, 10.0] {
            let model = model(robot, leg, slope);
            let angles = model.tripod_angles();
            let start = State::at_rest(model.standing_height(&angles), &angles);
            let walking = |_, _| if model.joints() == 6 { 12.0 } else { 0.5 };
            let shaking = |t: f64, j: usize| 10.0 * (37.0 * t + 11.0 * j as f64).sin();
            let [walk, shake] = [long::either(8.0, 60.0), long::either(4.0, 10.0)];
            for (what, met) in
                [("walking", share(&model, &start, walk, walking)), ("shaking", share(&model, &start, shake, shaking))]
            {
                assert!(met < 0.2, "{robot} {leg}, slope {slope}, {what}: {met}");
            }
        }
    }
}

/// Robots at rest, on their legs or on their back: decaying values end at zero.
#[test]
fn what_decays_ends_at_zero() {
    for (robot, leg) in long::first(2, FORMS) {
        let model = model(robot, leg, 0.0);
        let angles = model.tripod_angles();
        let standing = State::at_rest(model.standing_height(&angles), &angles);
        let mut lying = standing.clone();
        (lying.orientation, lying.position[2]) = ([0.0, 1.0, 0.0, 0.0], 0.05);
        for start in [&standing, &lying] {
            let mut engine = lanes::engine(Isa::choose().unwrap(), &model, 1).unwrap();
            engine.set_state(0, start);
            let mut state = start.clone();
            for _ in 0..3000 {
                sandgait_number::flushed(|| engine.advance(40));
            }
            engine.state(0, &mut state);
            let denormal = |x: &&f64| **x != 0.0 && x.abs() < f64::from(f32::MIN_POSITIVE);
            let row = state.row();
            assert_eq!(row.iter().filter(denormal).count(), 0, "{robot} {leg}: {row:?}");
        }
    }
}
