//! The plain gait of robots with six legs: how feet step, what it follows, and what a training takes from it.

#[path = "testbed/hexapod.rs"]
mod hexapod;
#[path = "testbed/packing.rs"]
mod packing;

use hexapod::{BESIDE, around, hexapod, model, options};
use sandgait::env::Shard;
use sandgait::env::legged::Units;
use sandgait::env::legged::prior::GaitPrior;
use sandgait::env::registry::Blueprint;
use sandgait::sim::tree::kinematics::chain;
use sandgait::sim::tree::plain_gait::{LegStride, PlainGait, StepOrder};
use sandgait::sim::tree::symmetry::Symmetry;
use sandgait::train::teacher::{self, Teacher};
use sandgait::train::{Hyperparameters, Mirror};
use serde_json::{Value, json};
use std::f64::consts::PI;

const ID: &str = "sandgait/LeggedVelocity-v1";

/// In the middle of a swing three feet are up, and no two of them are neighbours.
#[test]
fn six_legs_step_as_a_tripod() {
    for text in
        [hexapod(&BESIDE, true, 6.0, 1.0), hexapod(&BESIDE, false, 6.0, 1.0), hexapod(&around(), true, 6.0, 1.0)]
    {
        let robot = model(&text);
        assert_eq!(robot.stance.legs.len(), 6);
        assert!(robot.stance.angles.iter().all(|q| q.abs() < 1.4), "a joint stands at its stop");
        let gait = PlainGait::of(&robot).unwrap();
        let mut offsets = vec![0.0; robot.joints()];
        let tripod = LegStride { order: StepOrder::Alternating, duty_factor: 0.5, frequency: 2.0, lift: 0.03 };
        gait.offsets(tripod, [0.0; 3], 0.25, &mut offsets);
        let angles: Vec<f64> = robot.stance.angles.iter().zip(&offsets).map(|(q, off)| q + off).collect();
        let base = nalgebra::Isometry3::identity();
        let [still, moved] = [&robot.stance.angles, &angles].map(|q| chain(&robot.tree, base, q));
        let mut feet: Vec<(f64, bool)> = robot
            .stance
            .legs
            .iter()
            .map(|leg| {
                let end = leg[leg.len() - 1];
                let low = |frames: &[nalgebra::Isometry3<f64>]| {
                    sandgait::sim::tree::kinematics::lowest(&frames[end], &robot.contacts[end])
                };
                let at = low(&still);
                (at.y.atan2(at.x), low(&moved).z > at.z + 0.01)
            })
            .collect();
        feet.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert_eq!(feet.iter().filter(|f| f.1).count(), 3, "{feet:?}");
        assert!((0..6).all(|k| feet[k].1 != feet[(k + 1) % 6].1), "{feet:?}");
    }
}

/// In a ripple two of six feet are up, each for a third of the stride, and a leg steps half a stride after its mirror image, so that
/// a mirrored policy can walk so.
#[test]
fn six_legs_step_in_a_wave() {
    let robot = model(&hexapod(&BESIDE, true, 6.0, 1.0));
    let gait = PlainGait::of(&robot).unwrap();
    assert!(gait.has_wave());
    let ripple = LegStride { order: StepOrder::Wave, duty_factor: 2.0 / 3.0, frequency: 1.0, lift: 0.03 };
    let lifted = |phase: f64| -> Vec<bool> {
        let (mut still, mut moved) = (vec![0.0; robot.joints()], vec![0.0; robot.joints()]);
        gait.offsets(LegStride { lift: 0.0, ..ripple }, [0.0; 3], phase, &mut still);
        gait.offsets(ripple, [0.0; 3], phase, &mut moved);
        still.chunks(3).zip(moved.chunks(3)).map(|(still, moved)| still != moved).collect()
    };
    let sides = Symmetry::of(&robot).unwrap();
    for k in 0..12 {
        let phase = (f64::from(k) + 0.5) / 12.0;
        let (now, later) = (lifted(phase), lifted(phase + 0.5));
        assert_eq!(now.iter().filter(|up| **up).count(), 2, "{phase}: {now:?}");
        assert!((0..6).all(|leg| now[leg] == later[sides.joints[3 * leg] / 3]), "{phase}: {now:?} {later:?}");
    }
    // A leg in front is at no side, and along y a wave from back to front would not be mirrored.
    assert!(!PlainGait::of(&model(&hexapod(&around(), true, 6.0, 1.0))).unwrap().has_wave());
}

/// Thin legs that sink in must be lifted out, so a training gives them larger actions, which it says; a given scale stays.
#[test]
fn thin_legs_take_larger_steps() {
    let thin = hexapod(&BESIDE, true, 7.0, 1.0).replace("radius=\"0.012\"", "radius=\"0.008\"");
    let mut options = options(&thin);
    options["ground"] = "poppy-close".into();
    let blueprint = Blueprint::new(ID, options.clone()).unwrap();
    let walk = |scale| GaitPrior::of(blueprint.task.model(), scale, false, None).unwrap().unwrap();
    assert!(walk(Some(1.0)).is_better_than(&walk(None)) && !walk(Some(0.1)).is_better_than(&walk(None)));
    let given = json!(0.3);
    let mut own = options.clone();
    let suited = teacher::suit(&mut own, &Value::Null).unwrap();
    assert_eq!(own["action_scale"], json!(1.0));
    let settings = Hyperparameters { gait_prior: 1, ..Hyperparameters::default() };
    let teacher = Teacher::of(&Blueprint::new(ID, own).unwrap(), &settings).unwrap().unwrap();
    assert!(teacher.note(1, &suited).contains("action_scale is 1 rad"));
    options["action_scale"] = given.clone();
    teacher::suit(&mut options, &Value::Null).unwrap();
    assert_eq!(options["action_scale"], given);
}

/// Robots with fewer legs have no such start, and on sand slow servos ask for slow commands.
#[test]
fn commands_follow_from_servos_and_sand() {
    let speeds = |speed: f64, ground: &str| {
        let mut options = options(&hexapod(&BESIDE, true, speed, 1.0));
        options["ground"] = ground.into();
        let blueprint = Blueprint::new(ID, options).unwrap();
        let prior = GaitPrior::of(blueprint.task.model(), None, false, None).unwrap().unwrap();
        (prior.speeds(), Units::of(blueprint.task.model()).commanded())
    };
    let ((fast, ends), (slow, _), (hard, _)) =
        (speeds(7.0, "poppy-close"), speeds(1.0, "poppy-close"), speeds(7.0, "rigid"));
    for k in 0..3 {
        assert!(fast[k] <= ends[k] + 5e-3 && slow[k] >= 0.29 * ends[k], "{fast:?} {slow:?} {ends:?}");
    }
    assert!(slow[1] < 0.8 * fast[1], "{fast:?} {slow:?}");
    assert!(fast[0] < 0.8 * hard[0], "{fast:?} {hard:?}");
    let sandcat = Blueprint::new(ID, json!({})).unwrap();
    assert_eq!(GaitPrior::of(sandcat.task.model(), None, false, None).unwrap(), None);
}

/// The teacher of a robot on packed seeds, and a walk with it: the mean velocity forward, to the left [m/s] and yaw [rad/s] after the
/// first second, of four, under a command.
struct Taught {
    blueprint: Blueprint,
    teacher: Teacher,
}

impl Taught {
    fn new(text: &str) -> Self {
        let mut options = options(text);
        let model = Blueprint::new(ID, options.clone()).unwrap();
        let prior = GaitPrior::of(model.task.model(), None, false, None).unwrap().unwrap();
        options["gait_clock"] = json!(prior.stride.frequency);
        for name in ["curriculum", "domain_rand"] {
            options[name] = Value::Null;
        }
        let blueprint = Blueprint::new(ID, options).unwrap();
        let settings = Hyperparameters { gait_prior: 1, ..Hyperparameters::default() };
        let teacher = Teacher::of(&blueprint, &settings).unwrap().unwrap();
        Self { blueprint, teacher }
    }

    fn walk(&self, command: [f64; 3]) -> [f64; 3] {
        let mut shard = Shard::new(&self.blueprint, 1).unwrap();
        shard.reset(|_| true, Some(&[0]), |_| None);
        let info = &self.blueprint.task.spec().info;
        let columns =
            ["speed", "lin_vel_y", "ang_vel_yaw"].map(|name| info.iter().position(|c| c.name == name).unwrap());
        let (mut action, mut mean) = (vec![0.0; shard.actions()], [0.0; 3]);
        for step in 0..200 {
            shard.set_command(0, command);
            self.teacher.act(&shard.rows.observations, &mut action);
            shard.step(&action);
            if step >= 50 {
                (0..3).for_each(|k| mean[k] += f64::from(shard.rows.infos[columns[k]]) / 150.0);
            }
        }
        mean
    }
}

/// The gait is asked for what the trials say: it follows a command within a third, where asking for the command itself would not do.
#[test]
fn the_gait_follows_its_commands() {
    let taught = Taught::new(&hexapod(&BESIDE, true, 7.0, 1.0));
    for share in [0.4, 0.8] {
        let command = share * taught.teacher.prior.reached[0];
        let way = taught.walk([command, 0.0, 0.0])[0];
        assert!((way / command - 1.0).abs() < 0.33, "{way} of {command} m/s");
    }
}

/// A robot whose sides and ends differ follows commands along all six directions, and hardly drifts along the others. If trials went
/// along three directions, and a drift was left alone, it would turn as it walks to the side.
#[test]
fn the_gait_of_an_asymmetric_robot_follows_its_commands() {
    let mut places = BESIDE;
    (places[0][0], places[3][0], places[4][0]) = (0.14, 0.12, 0.03);
    let taught = Taught::new(&hexapod(&places, true, 7.0, 1.0));
    let reached = taught.teacher.prior.reached;
    for k in 0..6 {
        let (axis, mut command) = (k % 3, [0.0; 3]);
        command[axis] = if k < 3 { 0.5 } else { -0.5 } * reached[axis];
        let walked = taught.walk(command);
        let off: Vec<f64> = (0..3).map(|i| (walked[i] - command[i]) / (0.5 * reached[i])).collect();
        assert!(off.iter().all(|off| off.abs() < 0.25), "{command:?}: {walked:?}, off by {off:?} of a command");
    }
}

/// The gait of the mirrored robot is the mirror image of the gait: half a stride later if both groups of legs change places, else
/// at the same time.
#[test]
fn the_gait_of_the_mirror_image() {
    let turned = BESIDE.map(|[x, y, yaw]| [-y, x + 0.03, yaw + PI / 2.0]);
    for (places, clock) in [(BESIDE.to_vec(), -1.0), (around(), 1.0), (turned.to_vec(), -1.0)] {
        let mut options = options(&hexapod(&places, true, 6.0, 1.0));
        (options["max_velocity"], options["gait_clock"]) = (json!([0.2, 0.1, 0.5]), json!(2.0));
        let blueprint = Blueprint::new(ID, options).unwrap();
        let [observation, action] = Mirror::both(&blueprint).unwrap();
        let settings = Hyperparameters { gait_prior: 1, ..Hyperparameters::default() };
        let teacher = Teacher::of(&blueprint, &settings).unwrap().unwrap();
        let spec = blueprint.task.spec();
        let at = |name: &str| spec.observation.iter().position(|c| c.name == name).unwrap();
        assert_eq!(observation.signs[at("clock sine")], clock);
        let (mut row, width) = (vec![0.0; spec.observation.len()], spec.action.len());
        let asked = [("commanded lin_vel_x", 0.1), ("commanded lin_vel_y", 0.05), ("commanded ang_vel_yaw", 0.2)];
        for (name, value) in asked.into_iter().chain([("clock sine", 0.6), ("clock cosine", 0.8)]) {
            row[at(name)] = value;
        }
        let mut image = row.clone();
        observation.reflect(&row, &mut image);
        let [mut here, mut there, mut mirrored] = [vec![0.0; width], vec![0.0; width], vec![0.0; width]];
        teacher.act(&row, &mut here);
        teacher.act(&image, &mut there);
        action.reflect(&here, &mut mirrored);
        assert!(here.iter().any(|a| a.abs() > 0.05));
        mirrored.iter().zip(&there).for_each(|(a, b)| assert!((a - b).abs() < 0.02, "{mirrored:?} {there:?}"));
    }
}
