//! Standing pose, gains and legs of robots whose files have none; what is no legged robot; joints that follow others;
//! `--check` against a balance of forces of its own.

#[path = "testbed/made_robots.rs"]
mod made_robots;
#[path = "testbed/packing.rs"]
mod packing;

use made_robots::{BASE, INERTIAL, ball, joint, quadruped, read, shard_of};
use packing::pack;
use sandgait::env::ResetOptions;
use sandgait::env::registry::Blueprint;
use sandgait::env::shard::Shard;
use sandgait::robots::Import;
use sandgait::sand::Medium;
use sandgait::sim::tree::{TreeModel, packed};
use sandgait::train::describe;
use sandgait::train::teacher::suit;
use serde_json::{Value, json};
use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const ID: &str = "sandgait/LeggedVelocity-v1";

fn here(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

fn sandgait(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sandgait")).args(arguments).output().unwrap()
}

/// The foot is in the middle between the longest and the shortest reach; for two links of 0.2 m with a ball of 2 cm at the
/// end these follow from the knee's range.
#[test]
fn feet_are_in_the_middle_of_their_reach() {
    for (knee, upward) in [([-2.6, -0.6], false), ([-2.0, -0.2], false), ([-2.6, 2.6], false), ([-2.6, -0.6], true)] {
        let import = read(&quadruped(knee, upward), "urdf").unwrap();
        let reach = |bend: f64| 0.4 * (bend / 2.0).cos() + 0.02;
        let (straight, folded) = (knee.map(f64::abs).into_iter().fold(9.0, f64::min), knee[0].abs());
        let longest = if knee[1] > 0.0 { reach(0.0) } else { reach(straight) };
        let wanted = (longest + reach(folded).max(0.4 * longest)) / 2.0;
        let stance = &import.stance;
        assert_eq!((stance.legs.len(), stance.feet.len(), stance.upper.len()), (4, 4, 0), "{knee:?}");
        // The search tries heights in steps of 1/18 of the length.
        assert!((stance.leg_length - wanted).abs() < 0.42 / 18.0, "{knee:?} {upward}: {} {wanted}", stance.leg_length);
        let angles = &stance.angles;
        for leg in 1..4 {
            assert!((0..2).all(|k| (angles[2 * leg + k] - angles[k]).abs() < 0.02), "{knee:?}: {angles:?}");
        }
        // Knees point back.
        assert!(angles[1] < 0.0, "{knee:?}: {angles:?}");
    }
}

/// Share of its legs' length by which a robot sinks on hard ground under its servos alone, from joint angles with this noise
/// [rad].
fn sag(import: &Import, noise: f64) -> f64 {
    let options = json!({"robot": pack(import), "ground": "rigid", "domain_rand": null, "angle_noise": noise});
    let mut shard = Shard::new(&Blueprint::new(ID, options).unwrap(), 1).unwrap();
    shard.reset(|_| true, Some(&[0]), |_| None);
    let actions = vec![0.0; shard.actions()];
    (0..250).for_each(|_| shard.step(&actions));
    (import.stance.height - shard.state(0).position[2]) / import.stance.leg_length
}

/// Under its servos alone the robot sinks by about a twentieth of its legs' length, whatever `effort` its file has.
#[test]
fn found_gains_hold_the_robot() {
    let part = sag(&read(&quadruped([-2.6, -0.6], false), "urdf").unwrap(), 0.0);
    assert!((0.02..0.1).contains(&part), "{part}");
}

/// A leg whose knee stands right above its hip, on a long shank, does not buckle when it starts a little bent.
#[test]
fn legs_with_raised_knees_do_not_buckle() {
    let text = quadruped([-0.4, 0.4], false).replace("0 0 -0.2", "0 0 0.12");
    let text = text.replace(r#"xyz="0 0 0.12"/><geometry>"#, r#"xyz="0 0 -0.3"/><geometry>"#);
    let import = read(&text.replace("3.1", "0.4"), "urdf").unwrap();
    assert_eq!(import.stance.legs.len(), 4);
    let part = sag(&import, 0.1);
    assert!(part.abs() < 0.1, "{part}");
}

/// An arm, a drone and a pendulum are refused in one line that says what was looked for; a long chain is read quickly.
#[test]
fn what_is_no_legged_robot_is_refused() {
    let chain = |count: usize| {
        let mut text = format!(r#"<robot name="chain">{BASE}"#);
        for k in 0..count {
            text += &ball(&format!("l{k}"), 0.1);
            let parent = if k == 0 { "base".into() } else { format!("l{}", k - 1) };
            let axis = ["0 1 0", "1 0 0", "0 0 1"][k % 3];
            let limit = r#"<limit lower="-2" upper="2" effort="10" velocity="5"/>"#;
            text += &joint(&format!("j{k}"), &parent, &format!("l{k}"), "0 0 0.1", axis, limit);
        }
        text + "</robot>"
    };
    let drone = (0..4).fold(format!(r#"<robot name="drone">{BASE}"#), |text, k| {
        let blade = format!(r#"<link name="p{k}">{INERTIAL}<collision><geometry><box size="0.1 0.01 0.002"/></geometry></collision></link>"#);
        let at = format!("{} {} 0.06", [0.2, 0.2, -0.2, -0.2][k], [0.2, -0.2, 0.2, -0.2][k]);
        let joint = joint(&format!("r{k}"), "base", &format!("p{k}"), &at, "0 0 1", "").replace("revolute", "continuous");
        text + &blade + &joint
    }) + "</robot>";
    for (name, text) in [("arm", chain(6)), ("pendulum", chain(1)), ("drone", drone)] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(format!("{name}.urdf"));
        std::fs::write(&path, text).unwrap();
        let said = String::from_utf8(sandgait(&["robot", path.to_str().unwrap(), "--json"]).stdout).unwrap();
        assert!(said.contains("looked for"), "{name}: {said}");
        let output = sandgait(&["robot", path.to_str().unwrap(), "--pack"]);
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{name}: {error}");
        assert!(error.trim().lines().count() == 1 && error.contains("looked for"), "{name}: {error}");
    }
    let begin = std::time::Instant::now();
    let long = read(&chain(150), "urdf").unwrap();
    assert!(long.check_legged().is_err());
    assert!(begin.elapsed().as_secs_f64() < 5.0, "{:?}", begin.elapsed());
}

/// Legs whose first joint turns from straight ahead, or from straight back, to one side only stand in the middle of its range: beside
/// the body.
#[test]
fn a_hip_that_turns_to_one_side_stands_in_the_middle() {
    let leg = |name: &str, x: f64, y: f64| {
        let turned = if y > 0.0 { 0 } else { 180 };
        format!(
            r#"<body name="{name}" pos="{x} {y} 0" euler="0 0 {turned}"><joint name="{name}_hip" axis="0 0 1" range="0 180"/>
            <geom type="capsule" fromto="0 0 0 0.05 0 0" size="0.01"/>
            <body pos="0.05 0 0"><joint name="{name}_thigh" axis="0 1 0" range="-60 60"/>
            <geom type="capsule" fromto="0 0 0 0.08 0 0" size="0.01"/>
            <body pos="0.08 0 0"><joint name="{name}_shin" axis="0 1 0" range="-10 100"/>
            <geom type="capsule" fromto="0 0 0 0.15 0 0" size="0.01"/></body></body></body>"#
        )
    };
    let legs: String = [("a", 0.1), ("b", 0.0), ("c", -0.1)]
        .iter()
        .flat_map(|(name, x)| [leg(&format!("left_{name}"), *x, 0.06), leg(&format!("right_{name}"), *x, -0.06)])
        .collect();
    let text = format!(
        r#"<mujoco><worldbody><body name="base" pos="0 0 0.3"><freejoint/><geom type="box" size="0.12 0.06 0.02" mass="1"/>{legs}</body></worldbody></mujoco>"#
    );
    let import = read(&text, "xml").unwrap();
    let hips = import.tree.joints().zip(&import.stance.angles).filter(|(joint, _)| joint.name.ends_with("_hip"));
    let angles: Vec<f64> = hips.map(|(_, angle)| *angle).collect();
    assert_eq!((angles.len(), import.stance.legs.len()), (6, 6));
    assert!(angles.iter().all(|angle| (angle - PI / 2.0).abs() < 1e-6), "{angles:?}");
}

/// With `joints` "legs" an arm holds its default position and no number of the action moves it. `sandgait train` takes this for robots
/// with arms, unless the option is given or the training goes on without it.
#[test]
fn arms_hold_their_position() {
    let limit = r#"<limit lower="-3" upper="3" effort="50" velocity="50"/>"#;
    let arm = ball("arm", 0.05) + &joint("shoulder", "base", "arm", "0.3 0 0.2", "0 1 0", limit);
    let text = quadruped([-2.6, -0.6], false).replace(r#"<joint name="rr_hip""#, &(arm + r#"<joint name="rr_hip""#));
    let import = read(&text, "urdf").unwrap();
    let shoulder = import.tree.joints().position(|j| j.name == "shoulder").unwrap();
    let robot = pack(&import);
    let moved = |joints: &str| {
        let options =
            json!({"robot": robot, "ground": "rigid", "domain_rand": null, "angle_noise": 0.0, "joints": joints});
        let blueprint = Blueprint::new(ID, options).unwrap();
        let mut shard = Shard::new(&blueprint, 1).unwrap();
        shard.reset(|_| true, Some(&[0]), |_| None);
        let names: Vec<_> =
            blueprint.task.spec().action.iter().map(|column| column.name.contains("shoulder")).collect();
        let action: Vec<f32> = names.iter().map(|arm| if *arm { 1.0 } else { 0.0 }).collect();
        (0..50).for_each(|_| shard.step(&action));
        let about = describe::of_task(&blueprint, b"network");
        let held = about["held"].as_array().into_iter().flatten();
        let held: Vec<_> = held.map(|servo| servo["joint"].clone()).collect();
        let moved = (shard.state(0).angles[shoulder] - import.stance.angles[shoulder]).abs();
        (moved, names.len(), about["targets"].as_array().unwrap().len(), held)
    };
    let (legs, all) = (moved("legs"), moved("all"));
    let joints = import.tree.joints().count();
    assert!(legs.0 < 0.05 && all.0 > 0.2, "{legs:?} {all:?}");
    assert_eq!((legs.1, legs.2, legs.3), (joints - 1, joints - 1, vec![json!("shoulder")]));
    assert_eq!((all.1, all.2, all.3), (joints, joints, vec![]));
    let wrong = Blueprint::new(ID, json!({"robot": robot, "joints": "arms"})).err().unwrap().to_string();
    assert!(wrong.contains("joints \"arms\" is unknown"), "{wrong}");
    let suited = |given: Value, kept: Value| {
        let mut options = given;
        options["robot"] = json!(robot);
        let suited = suit(&mut options, &kept).unwrap();
        (options["joints"].clone(), suited.notes().len())
    };
    assert_eq!(suited(json!({}), Value::Null), (json!("legs"), 1));
    assert_eq!(suited(json!({"joints": "all"}), Value::Null), (json!("all"), 0));
    assert_eq!(suited(json!({}), json!({"ground": "rigid"})), (Value::Null, 0));
    assert_eq!(suited(json!({}), json!({"joints": "legs"})), (json!("legs"), 1));
}

/// A joint that follows another stays within 2 mrad of its line while the leader moves, within 20 mrad when feet hit the
/// ground, and is no action.
#[test]
fn joints_follow_others() {
    let text = quadruped([-2.6, -0.6], false).replace(
        r#"<joint name="rr_hip""#,
        &(ball("tail", 0.05)
            + &joint("tail_joint", "base", "tail", "-0.3 0 0.1", "0 1 0", r#"<limit lower="-3" upper="3" effort="50" velocity="50"/><mimic joint="fl_hip" multiplier="-0.5" offset="0.2"/>"#)
            + r#"<joint name="rr_hip""#),
    );
    let import = read(&text, "urdf").unwrap();
    let names: Vec<_> = import.tree.joints().map(|j| j.name.clone()).collect();
    let [tail, leader] = ["tail_joint", "fl_hip"].map(|name| names.iter().position(|n| n == name).unwrap());
    let options = json!({"robot": pack(&import), "ground": "rigid", "domain_rand": null, "angle_noise": 0.0, "action_scale": 1.0});
    let blueprint = Blueprint::new(ID, options).unwrap();
    let actions = &blueprint.task.spec().action;
    assert_eq!(actions.len(), names.len() - 1);
    assert!(actions.iter().all(|column| !column.name.contains("tail")));
    let mut shard = Shard::new(&blueprint, 1).unwrap();
    shard.reset(|_| true, Some(&[0]), |_| None);
    let mut run = |size: f64| {
        let (mut farthest, mut moved) = (0.0_f64, 0.0_f64);
        shard.reset(|_| true, Some(&[0]), |_| None);
        for k in 0..100 {
            let bend = (size * (TAU * f64::from(k) / 50.0).sin()) as f32;
            shard.step(&vec![bend; names.len() - 1]);
            let angles = &shard.state(0).angles;
            farthest = farthest.max((angles[tail] - (0.2 - 0.5 * angles[leader])).abs());
            moved = moved.max((angles[leader] - import.stance.angles[leader]).abs());
        }
        (farthest, moved)
    };
    // The robot bows, and it jumps and falls.
    let ((gentle, bowed), (hard, jumped)) = (run(0.05), run(0.3));
    assert!(bowed > 0.03 && gentle < 0.002, "{bowed} {gentle}");
    assert!(jumped > 0.3 && hard < 0.02, "{jumped} {hard}");
    let wrong = text.replace(r#"joint="fl_hip""#, r#"joint="nobody""#);
    assert!(read(&wrong, "urdf").err().unwrap().contains("nobody"));
}

/// Closed chains are refused with the names of both bodies and what to do.
#[test]
fn closed_chains_are_refused_by_name() {
    let text = std::fs::read_to_string(here("robots/sandcat.xml")).unwrap();
    let closed = text.replace(
        "</mujoco>",
        r#"<equality><connect body1="FL_calf" body2="FR_calf" anchor="0 0 0"/></equality></mujoco>"#,
    );
    let error = read(&closed, "xml").err().unwrap();
    assert!(error.contains("\"FL_calf\" and \"FR_calf\"") && error.contains("delete"), "{error}");
    let curve = text.replace(
        "</mujoco>",
        r#"<equality><joint joint1="FL_knee" joint2="FR_knee" polycoef="0 1 0.5 0 0"/></equality></mujoco>"#,
    );
    assert!(read(&curve, "xml").err().unwrap().contains("polycoef"));
    let line = text.replace(
        "</mujoco>",
        r#"<equality><joint joint1="FL_knee" joint2="FR_knee" polycoef="0.1 1 0 0 0"/></equality></mujoco>"#,
    );
    let import = read(&line, "xml").unwrap();
    let follower = import.tree.joints().find(|j| j.name == "FL_knee").and_then(|j| j.mimic.clone()).unwrap();
    assert_eq!((follower.leader.as_str(), follower.ratio, follower.offset), ("FR_knee", 1.0, 0.1));
}

/// The pose of a file in which the legs do not stand is replaced by one that is found.
#[test]
fn a_pose_that_does_not_stand_is_replaced() {
    let text = std::fs::read_to_string(here("robots/sandcat.xml")).unwrap();
    let key = text.lines().find(|l| l.contains("<key")).unwrap();
    let up = "0 0 0.3 1 0 0 0 ".to_owned() + &"0 2.6 -0.4 ".repeat(4);
    let start = key.find("qpos=\"").unwrap() + 6;
    let end = start + key[start..].find('"').unwrap();
    let changed = text.replace(&key[start..end], up.trim());
    let import = read(&changed, "xml").unwrap();
    assert_eq!(import.stance.legs.len(), 4);
    assert!(import.warnings.iter().any(|w| w.contains("standing pose")), "{:?}", import.warnings);
}

/// After a reset with new pose, gains, commands, pushes and ground the environment is bit-identical to one that was
/// made with these options.
#[test]
fn resets_change_gains_commands_and_ground() {
    let changes = json!({
        "stiffness": {"knee": 35.0}, "damping": {"*": 0.8}, "default_joint_angles": {"knee": -1.7}, "ground": "rigid",
        "commands": {"lin_vel_x": [0.5, 0.5]}, "domain_rand": {"push_interval": 0.5},
    });
    let first = Blueprint::new(ID, json!({"ground": "poppy-close"})).unwrap();
    let made = Blueprint::new(ID, changes.clone()).unwrap();
    let changed = first.task.changed(&ResetOptions::new(changes).unwrap()).unwrap();
    let mut one = shard_of(&first);
    one.step(&[0.1; 12]);
    one.reset(|_| true, Some(&[3]), |_| Some(&changed));
    let mut other = shard_of(&made);
    for k in 0..60 {
        let action = (0.4 * f64::from(k).sin()) as f32;
        one.step(&[action; 12]);
        other.step(&[action; 12]);
        assert_eq!(one.rows.observations, other.rows.observations, "{k}");
        assert_eq!(one.rows.infos, other.rows.infos, "{k}");
    }
    let refused = |options: Value| first.task.changed(&ResetOptions::new(options).unwrap()).err().unwrap().to_string();
    assert!(refused(json!({"ground": "dunes"})).contains("make other environments"));
    assert!(refused(json!({"stiffness": {"tail": 1.0}})).contains("matches no joint"));
    assert!(refused(json!({"stiffness": {"knee": -1.0}})).contains("stiffness"));
}

/// Vertical force on a ball [N] whose lowest point is at `depth`, when it moves down in `medium`: the integral of the law of
/// Li et al. 2013 (equation S1 with γ = 90°) over rings of the lower half. A foot never moves exactly straight down, so cos 2β
/// of a plate is that in the plane of the motion (docs/physics.md); its mean over a ring is cos² t − sin² t/2.
fn ball_force(medium: &Medium, radius: f64, depth: f64) -> f64 {
    let c = medium.coefficients;
    const RINGS: usize = 20_000;
    let ring = |k: usize| {
        let tilt = (k as f64 + 0.5) / RINGS as f64 * PI / 2.0;
        let under = depth - radius * (1.0 - tilt.cos());
        let alpha = c.a00 + c.b01 + (c.a10 + c.b11 + c.bm11) * (tilt.cos().powi(2) - tilt.sin().powi(2) / 2.0);
        let area = TAU * radius * radius * tilt.sin() * (PI / 2.0 / RINGS as f64);
        alpha.max(0.0) * under.max(0.0) * area
    };
    (0..RINGS).map(ring).sum()
}

/// Radius of the feet of [`stool`] [m].
const FOOT: f64 = 0.03;

/// A robot on four balls whose legs slide up and down, so that its feet move straight down.
fn stool() -> String {
    let mut text = format!(r#"<robot name="stool">{BASE}"#);
    for (k, name) in ["fl", "fr", "rl", "rr"].iter().enumerate() {
        let at = format!("{} {} 0", [0.2, 0.2, -0.2, -0.2][k], [0.15, -0.15, 0.15, -0.15][k]);
        let limit = r#"<limit lower="-0.1" upper="0.1" effort="500" velocity="5"/>"#;
        let foot = ball(&format!("{name}_foot"), -0.25).replace("0.02\"", &format!("{FOOT}\""));
        text += &(foot + &joint(name, "base", &format!("{name}_foot"), &at, "0 0 1", limit));
    }
    text.replace("revolute", "prismatic") + "</robot>"
}

/// The sinkage that `--check` prints is that of the balance of forces on the feet, within 5 %.
#[test]
fn sinkage_is_that_of_the_balance_of_forces() {
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("stool.urdf");
    std::fs::write(&robot, stool()).unwrap();
    for ground in ["poppy-close", "poppy-loose"] {
        let arguments = ["robot", robot.to_str().unwrap(), "--check", "--ground", ground, "--json"];
        let output = sandgait(&arguments);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let sheet: Value = serde_json::from_slice(&output.stdout).unwrap();
        let medium = Medium::named(ground).unwrap();
        let sand = sheet["grounds"].as_array().unwrap().iter().find(|g| g["ground"] == ground).unwrap();
        let mut sum = 0.0;
        assert_eq!(sand["feet"].as_array().unwrap().len(), 4);
        for foot in sand["feet"].as_array().unwrap() {
            let (load, sinkage) = (foot["load"].as_f64().unwrap(), foot["sinkage"].as_f64().unwrap());
            sum += load;
            let [mut low, mut high] = [0.0, 1.0];
            for _ in 0..60 {
                let middle = (low + high) / 2.0;
                if ball_force(&medium, FOOT, middle) < load { low = middle } else { high = middle }
            }
            assert!((sinkage / low - 1.0).abs() < 0.05, "{ground}: {sinkage} {low} {load}");
        }
        let weight = sand["weight"].as_f64().unwrap();
        assert!((sum / weight - 1.0).abs() < 0.02, "{ground}: {sum} {weight}");
    }
}

/// `--check` says what it found, with exit code 0, 1 or 2.
#[test]
fn check_has_exit_codes() {
    let robot = here("robots/sandcat.xml");
    let robot = robot.to_str().unwrap();
    let stands = sandgait(&["robot", robot, "--check"]);
    assert_eq!(stands.status.code(), Some(0), "{}", String::from_utf8_lossy(&stands.stdout));
    let said = String::from_utf8(stands.stdout).unwrap();
    assert!(
        said.contains("on rigid: stands") && said.contains("on poppy-close: stands") && said.contains("steps/s"),
        "{said}"
    );
    // Sand of a hundredth of the strength does not carry the robot.
    let sinks = sandgait(&["robot", robot, "--check", "--ground", "zeta=0.005"]);
    assert_eq!(sinks.status.code(), Some(1), "{}", String::from_utf8_lossy(&sinks.stdout));
    assert_eq!(sandgait(&["robot", robot, "--check", "--ground", "lava"]).status.code(), Some(2));
    assert_eq!(sandgait(&["robot", robot, "--ground", "rigid"]).status.code(), Some(2));
}

/// A packed file is taken as a robot, and packs to the same text.
#[test]
fn packed_files_are_robots() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cat.json");
    let text = sandgait(&["robot", here("robots/sandcat.xml").to_str().unwrap(), "--pack"]).stdout;
    std::fs::write(&path, &text).unwrap();
    let path = path.to_str().unwrap();
    assert_eq!(sandgait(&["robot", path, "--pack"]).stdout, text);
    let printed = String::from_utf8(sandgait(&["robot", path]).stdout).unwrap();
    assert!(printed.contains("(packed)") && printed.contains("4 legs"), "{printed}");
    let model: TreeModel = packed::unpack_compressed(std::str::from_utf8(&text).unwrap().trim()).unwrap();
    assert!(model.tree.joints().all(|j| j.rest.is_some() && j.kp.is_some() && j.kd.is_some()));
}
