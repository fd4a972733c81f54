//! Robots with six legs from files: inertias, symmetry, and what a training starts from.

#[path = "testbed/hexapod.rs"]
mod hexapod;
#[path = "testbed/legged_training.rs"]
mod legged_training;
#[path = "testbed/packing.rs"]
mod packing;

use hexapod::{BESIDE, around, hexapod, model, options, read};
use sandgait::env::Shard;
use sandgait::env::legged::Units;
use sandgait::env::registry::Blueprint;
use sandgait::robots::{self, InertiaSource, Reading};
use sandgait::sim::tree::TreeModel;
use sandgait::sim::tree::plain_gait::PlainGait;
use sandgait::sim::tree::symmetry::{Sides, Symmetry};
use sandgait::train::{Mirror, TrainingRequest, entry};
use serde_json::{Value, json};
use std::f64::consts::PI;

const ID: &str = "sandgait/LeggedVelocity-v1";

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
