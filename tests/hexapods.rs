//! Robots with six legs from files: their plain gait, the commands that suit them, and what a training starts from.

#[path = "testbed/legged_training.rs"]
mod legged_training;
#[path = "testbed/packing.rs"]
mod packing;

use packing::pack;
use sandgait::env::Shard;
use sandgait::env::legged::Units;
use sandgait::env::legged::prior::GaitPrior;
use sandgait::env::registry::Blueprint;
use sandgait::robots::{self, Import, InertiaSource, Reading};
use sandgait::sim::tree::TreeModel;
use sandgait::sim::tree::kinematics::chain;
use sandgait::sim::tree::plain_gait::{LegStride, PlainGait, StepOrder};
use sandgait::sim::tree::symmetry::{Sides, Symmetry};
use sandgait::train::teacher::{self, Teacher};
use sandgait::train::{Hyperparameters, Mirror, TrainingRequest, entry};
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::fmt::Write as _;

const ID: &str = "sandgait/LeggedVelocity-v1";

/// A hexapod whose two or three joints a leg turn with at most `speed` [rad/s]: the first turns the leg about the
/// vertical, the others lift it. `places`: x, y [m] and direction [rad] of each leg; `inertia`: factor on all inertias.
fn hexapod(places: &[[f64; 3]], knees: bool, speed: f64, inertia: f64) -> String {
    let mut text = String::from("<robot name=\"hexapod\">");
    let inertial = |mass: f64, moment: f64, x: f64| {
        let i = moment * inertia;
        format!(
            "<inertial><origin xyz=\"{x} 0 0\"/><mass value=\"{mass}\"/>\
             <inertia ixx=\"{i}\" ixy=\"0\" ixz=\"0\" iyy=\"{i}\" iyz=\"0\" izz=\"{i}\"/></inertial>"
        )
    };
    let rod = |x: f64, length: f64, radius: f64| {
        format!(
            "<collision><origin xyz=\"{x} 0 0\" rpy=\"0 {} 0\"/><geometry>\
             <cylinder radius=\"{radius}\" length=\"{length}\"/></geometry></collision>",
            PI / 2.0
        )
    };
    let body = "<collision><geometry><box size=\"0.2 0.14 0.05\"/></geometry></collision>";
    write!(text, "<link name=\"base\">{}{body}</link>", inertial(1.4, 6e-3, 0.0)).unwrap();
    for (k, [x, y, yaw]) in places.iter().enumerate() {
        let lengths: &[f64] = if knees { &[0.05, 0.08, 0.13] } else { &[0.06, 0.16] };
        let (mut parent, mut at) = ("base".to_owned(), format!("xyz=\"{x} {y} 0\" rpy=\"0 0 {yaw}\""));
        for (j, length) in lengths.iter().enumerate() {
            let name = format!("leg{k}_{j}");
            let foot = if j + 1 == lengths.len() {
                format!(
                    "<collision><origin xyz=\"{length} 0 0\"/><geometry><sphere radius=\"0.012\"/></geometry></collision>"
                )
            } else {
                String::new()
            };
            let axis = if j == 0 { "0 0 1" } else { "0 1 0" };
            write!(
                text,
                "<link name=\"{name}\">{}{}{foot}</link><joint name=\"{name}\" type=\"revolute\"><parent link=\"{parent}\"/>\
                 <child link=\"{name}\"/><origin {at}/><axis xyz=\"{axis}\"/>\
                 <limit lower=\"-1.5\" upper=\"1.5\" effort=\"2\" velocity=\"{speed}\"/></joint>",
                inertial(0.08, 1e-4, length / 2.0),
                rod(length / 2.0, *length, 0.01),
            )
            .unwrap();
            (parent, at) = (name, format!("xyz=\"{length} 0 0\""));
        }
    }
    text + "</robot>"
}

/// Three legs at each side.
const BESIDE: [[f64; 3]; 6] = [
    [0.1, 0.07, 0.6],
    [0.0, 0.08, PI / 2.0],
    [-0.1, 0.07, PI - 0.6],
    [0.1, -0.07, -0.6],
    [0.0, -0.08, -PI / 2.0],
    [-0.1, -0.07, 0.6 - PI],
];

/// Six legs on a circle, one of them in front and one behind.
fn around() -> Vec<[f64; 3]> {
    (0..6).map(|k| f64::from(k) * PI / 3.0).map(|yaw| [0.1 * yaw.cos(), 0.1 * yaw.sin(), yaw]).collect()
}

fn read(text: &str) -> Import {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.urdf");
    std::fs::write(&path, text).unwrap();
    robots::load(&path).unwrap()
}

fn model(text: &str) -> TreeModel {
    let tree = read(text).tree;
    let bodies = tree.bodies.len();
    TreeModel::new(tree, vec![Vec::new(); bodies]).unwrap()
}

/// LeggedVelocity on packed seeds with this robot.
fn options(text: &str) -> Value {
    let import = read(text);
    json!({"robot": pack(&import), "ground": "poppy-close"})
}

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

/// Legs on a circle: those in front and behind are legs, and each is its own mirror image.
#[test]
fn a_circle_of_legs_has_a_mirror_image() {
    let robot = model(&hexapod(&around(), true, 6.0, 1.0));
    let sides = Symmetry::of(&robot).unwrap();
    // Leg 0 in front, then to the left and around: 1 mirrors to 5, 2 to 4, and 3 to itself.
    let legs: Vec<usize> = sides.joints.iter().step_by(3).map(|k| k / 3).collect();
    assert_eq!(legs, [0, 5, 4, 3, 2, 1]);
    assert_eq!(sides.signs, [-1.0, 1.0, 1.0].repeat(6));
    // The leg in front steps with its own mirror image, so both groups of a tripod keep their legs. With three legs at each
    // side a leg's image is in the other group.
    let swaps = |robot: &TreeModel, sides: &Symmetry| PlainGait::of(robot).unwrap().swaps(&sides.joints);
    assert_eq!(swaps(&robot, &sides), Some(false));
    let beside = model(&hexapod(&BESIDE, true, 6.0, 1.0));
    assert_eq!(swaps(&beside, &Symmetry::of(&beside).unwrap()), Some(true));
}

/// A robot whose front is along y is symmetric in front and back.
#[test]
fn a_front_along_y_is_mirrored() {
    let turned = BESIDE.map(|[x, y, yaw]| [-y, x + 0.03, yaw + PI / 2.0]);
    let robot = model(&hexapod(&turned, true, 6.0, 1.0));
    assert_eq!(Symmetry::of(&robot).unwrap().sides, Sides::FrontBack);
    let notes = Mirror::notes(&Blueprint::new(ID, options(&hexapod(&turned, true, 6.0, 1.0))).unwrap());
    assert!(notes[0].contains("symmetric in front and back, not in left and right"), "{notes:?}");
}

/// Inertias of other units are replaced, which the first line says; plausible ones stay to the bit.
#[test]
fn implausible_inertias_are_replaced() {
    let [own, large] = [1.0, 800.0].map(|factor| read(&hexapod(&BESIDE, true, 6.0, factor)));
    assert!(own.warnings.iter().all(|line| !line.contains("inertia")), "{:?}", own.warnings);
    assert_eq!(own.tree.bodies[0].inertia[(0, 0)], 6e-3);
    let said = &large.warnings[0];
    assert!(said.contains("19 bodies: their inertias are replaced by that of a box around the shapes"), "{said}");
    for body in &large.tree.bodies {
        let gyration = (body.inertia.symmetric_eigenvalues().max() / body.mass).sqrt();
        assert!((0.003..0.1).contains(&gyration), "{}: {gyration} m", body.name);
    }
    // A box of 0.2 m × 0.14 m × 0.05 m.
    let x = large.tree.bodies[0].inertia[(0, 0)];
    assert!((x / (1.4 * (0.14_f64.powi(2) + 0.05_f64.powi(2)) / 12.0) - 1.0).abs() < 0.02, "{x}");
}

/// In URDF and MJCF a moment above the sum of the others is replaced, and a thin plate's stays; `file` keeps all.
#[test]
fn moments_above_the_sum_of_the_others_are_replaced() {
    let urdf = |moments: [f64; 3]| {
        let [x, y, z] = moments;
        format!(
            "<robot name=\"r\"><link name=\"base\"><inertial><mass value=\"2\"/><inertia ixx=\"{x}\" iyy=\"{y}\" izz=\"{z}\" \
             ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial><collision><geometry><box size=\"0.3 0.3 0.3\"/></geometry></collision>\
             </link></robot>"
        )
    };
    let mjcf = |[x, y, z]: [f64; 3]| {
        format!(
            "<mujoco model=\"r\"><worldbody><body name=\"base\"><freejoint/><inertial pos=\"0 0 0\" mass=\"2\" \
             diaginertia=\"{x} {y} {z}\"/><geom type=\"box\" size=\"0.15 0.15 0.15\"/></body></worldbody></mujoco>"
        )
    };
    let folder = tempfile::tempdir().unwrap();
    let moments = |name: &str, text: String, inertia| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let reading = Reading { inertia, ..Reading::default() };
        let import = robots::load_from(&path, &Default::default(), &reading).unwrap();
        let said = import.warnings.iter().any(|line| line.contains("a principal moment above the sum of the others"));
        let replaced = import.warnings.first().is_some_and(|line| line.contains("is replaced by that of a box"));
        assert!(said == replaced || inertia == InertiaSource::File, "{:?}", import.warnings);
        (import.tree.bodies[0].inertia.diagonal().as_slice().to_owned(), replaced)
    };
    let plausible = InertiaSource::default();
    for (impossible, flat) in [([0.01, 0.01, 0.03], [0.015, 0.015, 0.03]), ([0.002, 0.04, 0.03], [0.01, 0.04, 0.03])] {
        for (name, text) in [("r.urdf", urdf as fn([f64; 3]) -> String), ("r.xml", mjcf)] {
            let (found, replaced) = moments(name, text(impossible), plausible);
            // A cube of 0.3 m and 2 kg.
            assert!(replaced && found.iter().all(|m| (m - 0.03).abs() < 1e-12), "{name}: {found:?}");
            assert_eq!(moments(name, text(impossible), InertiaSource::File), (impossible.to_vec(), false));
            assert_eq!(moments(name, text(flat), plausible), (flat.to_vec(), false));
        }
    }
    assert!("moon".parse::<InertiaSource>().unwrap_err().to_string().contains("plausible"));
}

fn request(options: Value, out: &std::path::Path, changes: &[&str], timesteps: u64) -> TrainingRequest {
    let mut all: Vec<_> = changes.iter().map(|c| entry::pair("--set", c).unwrap()).collect();
    all.extend(entry::ends(Some(timesteps), None).unwrap());
    legged_training::request(options, out, all)
}

/// The plain command sets clock and commands of a hexapod, the policy comes near to the gait while it imitates it, and
/// options that are given stay.
#[test]
fn a_training_begins_with_the_plain_gait() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(&hexapod(&BESIDE, true, 6.0, 1.0));
    let small = ["n_envs=32", "n_steps=16", "batch_size=256", "n_epochs=10"];
    let out = folder.path().join("own");
    let trained = request(options.clone(), &out, &small, 20_000).run(&sandgait::progress::Silent).unwrap();
    let settings: Value = serde_json::from_slice(&std::fs::read(out.join("settings.json")).unwrap()).unwrap();
    let (clock, speeds) = (&settings["options"]["gait_clock"], &settings["options"]["max_velocity"]);
    // Strides are short enough for the learner.
    assert!(clock.as_f64().unwrap() > 1.7 && speeds[0].as_f64().unwrap() > 0.05, "{clock} {speeds}");
    // While it imitates, the policy's loss is half of the squared distance from the gait's action.
    let last = trained.last.unwrap();
    assert!(last.policy_loss > 0.0 && last.policy_loss < 0.6, "{}", last.policy_loss);
    // The curriculum has hardly begun, so the noise of actions has not fallen.
    assert!(last.deviation > 0.2, "{}", last.deviation);
    assert_eq!(settings["options"]["tracking_sigma"], json!(0.03));
    assert_eq!(settings["options"]["commands"]["single_axis"], json!(0.5));
    // Given options stay, and without the setting nothing is added.
    let mut given = options.clone();
    (given["max_velocity"], given["gait_clock"]) = (json!([0.1, 0.1, 0.5]), json!(1.5));
    given["tracking_sigma"] = json!(0.2);
    given["commands"] = json!({"single_axis": 0.25});
    let out = folder.path().join("given");
    request(given, &out, &small, 512).run(&sandgait::progress::Silent).unwrap();
    let settings: Value = serde_json::from_slice(&std::fs::read(out.join("settings.json")).unwrap()).unwrap();
    assert_eq!(
        (&settings["options"]["max_velocity"], &settings["options"]["gait_clock"]),
        (&json!([0.1, 0.1, 0.5]), &json!(1.5))
    );
    assert_eq!(settings["options"]["tracking_sigma"], json!(0.2));
    assert_eq!(settings["options"]["commands"]["single_axis"], json!(0.25));
    let out = folder.path().join("plain");
    request(options, &out, &[&small[..], &["gait_prior=0"]].concat(), 512).run(&sandgait::progress::Silent).unwrap();
    let settings: Value = serde_json::from_slice(&std::fs::read(out.join("settings.json")).unwrap()).unwrap();
    assert!(settings["options"].get("gait_clock").is_none());
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

/// Over many steps shaped tracking terms differ from the plain ones only by what the mean velocity's term has changed from the first to
/// the last, so no other way to walk becomes better; without a clock they are the same.
#[test]
fn shaped_tracking_terms_have_the_same_sum() {
    let rewards = |clock: Value, shaping: bool| -> Vec<[f64; 2]> {
        let options = json!({
            "gait_clock": clock, "tracking_shaping": shaping, "curriculum": null, "domain_rand": null, "ground": "rigid"
        });
        let blueprint = Blueprint::new(ID, options).unwrap();
        let info = &blueprint.task.spec().info;
        let at = |name: &str| info.iter().position(|column| column.name == name).unwrap();
        let columns = [at("reward_tracking_lin_vel"), at("reward_tracking_ang_vel")];
        let mut shard = Shard::new(&blueprint, 1).unwrap();
        shard.reset(|_| true, Some(&[0]), |_| None);
        shard.set_command(0, [0.3, 0.0, 0.2]);
        let mut step = |k: u32| {
            shard.step(&[(0.3 * f64::from(k).sin()) as f32; 12]);
            // Rates per second and weights of 1 and 0.5.
            let term = |i: usize| f64::from(shard.rows.infos[columns[i]]) * 50.0;
            [term(0), term(1) / 0.5]
        };
        (0..120).map(&mut step).collect()
    };
    let units = Units::of(Blueprint::new(ID, json!({})).unwrap().task.model()).commanded();
    let first = [0.3 / units[0], 0.2 / units[2]].map(|off: f64| (-off.powi(2) / 0.1).exp());
    let (plain, shaped) = (rewards(json!(1.25), false), rewards(json!(1.25), true));
    let steps_of_a_stride = 50.0 / 1.25;
    for i in 0..2 {
        let sum = |all: &[[f64; 2]]| all.iter().map(|terms| terms[i]).sum::<f64>();
        let change = plain.last().unwrap()[i] - first[i];
        assert!(change.abs() > 3e-3, "the robot does nothing: {change}");
        let expected = (steps_of_a_stride - 1.0) * change;
        let more = sum(&shaped) - sum(&plain);
        assert!((more - expected).abs() < 1e-3, "term {i}: {more}, expected {expected}");
    }
    assert_eq!(rewards(Value::Null, true), rewards(Value::Null, false));
}
