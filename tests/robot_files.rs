//! Descriptions as others write them: bodies beside the robot, pictures that are missing, pairs of contact, poses that
//! joints cannot take, legs that move in a plane, robots on two legs.

use sandgait::robots::posture::Posture;
use sandgait::robots::{self, Import};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A quadruped of 9 kg as MJCF. `feet` are attributes of the feet, `inside` elements of the base, `beside` elements of the
/// world after the robot, and `after` sections of the file.
fn quadruped(feet: &str, inside: &str, beside: &str, after: &str) -> String {
    let mut legs = String::new();
    for (name, x, y) in [("FL", 0.2, 0.1), ("FR", 0.2, -0.1), ("RL", -0.2, 0.1), ("RR", -0.2, -0.1)] {
        let [knee, foot] = [0.3 * y, 0.2 * y];
        legs += &format!(
            r#"<body name="{name}_thigh" pos="{x} {y} 0"><inertial pos="0 0 -0.1" mass="0.4" diaginertia="1e-3 1e-3 1e-3"/>
              <joint name="{name}_hip" axis="0 1 0" range="-2 2" limited="true"/>
              <body name="{name}_calf" pos="0 {knee} -0.2"><inertial pos="0 0 -0.1" mass="0.1" diaginertia="3e-4 3e-4 1e-4"/>
                <joint name="{name}_knee" axis="0 1 0" range="-2.6 -0.3" limited="true"/>
                <geom name="{name}_foot" type="sphere" size="0.02" pos="0 {foot} -0.2" {feet}/></body></body>"#
        );
    }
    format!(
        r#"<mujoco model="own"><compiler angle="radian"/><asset><mesh name="shell" file="shell.obj"/></asset>
        <worldbody><body name="base" pos="0 0 0.3"><freejoint/><inertial pos="0 0 0" mass="7" diaginertia="0.1 0.1 0.1"/>
          <geom type="box" size="0.2 0.08 0.05"/>{inside}{legs}</body>{beside}</worldbody>{after}</mujoco>"#
    )
}

fn written(folder: &Path, text: &str) -> PathBuf {
    let path = folder.join("robot.xml");
    std::fs::write(&path, text).unwrap();
    path
}

fn read(text: &str) -> Result<Import, String> {
    let folder = tempfile::tempdir().unwrap();
    robots::load(&written(folder.path(), text)).map_err(|e| e.to_string())
}

/// What `sandgait robot FILE --check --json` prints: by ground, why the robot does not stand; "" if it does.
fn falls(path: &Path) -> Vec<(String, String)> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
    let output = command.args(["robot", path.to_str().unwrap(), "--check", "--json"]).output().unwrap();
    let sheet: Value = serde_json::from_slice(&output.stdout).expect("a sheet");
    let grounds = sheet["grounds"].as_array().unwrap();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    grounds.iter().map(|g| (text(&g["ground"]), text(&g["reason"]))).collect()
}

/// unitree_mujoco has bodies at 20 m whose joints stand for motors that a robot lacks.
#[test]
fn bodies_beside_the_robot_are_left_out_with_their_motors() {
    let beside = r#"<body name="unused" pos="0 0 20"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="unused"/></body>"#;
    let motors = r#"<actuator><motor joint="FL_hip" ctrlrange="-20 20"/><motor joint="unused"/></actuator>"#;
    let pose = "0.1 -0.9 0.2 -0.9 0.3 -0.9 0.4 -0.9";
    let key = format!(r#"<keyframe><key qpos="0 0 0.3 1 0 0 0 {pose} 0.7"/></keyframe>"#);
    let import = read(&quadruped("", "", beside, &format!("{motors}{key}"))).unwrap();
    assert_eq!(import.tree.joints().count(), 8);
    assert_eq!(import.tree.joints().next().unwrap().torque_limit, Some(20.0));
    assert_eq!(import.stance.angles, [0.1, -0.9, 0.2, -0.9, 0.3, -0.9, 0.4, -0.9]);
    assert!(
        import.warnings.iter().any(|w| w.contains("unused") && w.contains("beside the robot")),
        "{:?}",
        import.warnings
    );

    let wrong = read(&quadruped("", "", "", motors)).err().unwrap();
    assert!(wrong.contains("there is no joint \"unused\""), "{wrong}");
}

/// dm_control's quadruped and dog have a ball to play with. A second free body with joints is a second robot.
#[test]
fn free_bodies_without_joints_are_left_out() {
    let ball = r#"<body name="ball" pos="1 0 0.1"><freejoint/><geom size="0.1"/></body>"#;
    let (alone, with) = (read(&quadruped("", "", "", "")).unwrap(), read(&quadruped("", "", ball, "")).unwrap());
    assert_eq!(with.tree.bodies.len(), alone.tree.bodies.len());
    assert!(with.warnings.iter().any(|w| w.contains("1 <body>")), "{:?}", with.warnings);
    let other = r#"<body name="other"><freejoint/><geom size="0.1"/><body><joint/><geom size="0.1"/></body></body>"#;
    let wrong = read(&quadruped("", "", other, "")).err().unwrap();
    assert!(wrong.contains("two robots"), "{wrong}");
}

/// A picture's mesh that is missing is a warning; where a geom collides with it or has its mass, the file is refused.
#[test]
fn a_missing_mesh_is_refused_only_where_it_is_needed() {
    let drawn = r#"<geom type="mesh" mesh="shell" contype="0" conaffinity="0"/>"#;
    let import = read(&quadruped("", drawn, "", "")).unwrap();
    assert!(import.warnings.iter().any(|w| w.contains("shell") && w.contains("not drawn")), "{:?}", import.warnings);

    let in_calf = |attributes: &str| {
        format!(r#"<body><joint name="tail" axis="0 1 0"/><geom type="mesh" mesh="shell" {attributes}/></body>"#)
    };
    let weighs = in_calf(r#"contype="0" conaffinity="0""#);
    for needed in [r#"<geom type="mesh" mesh="shell"/>"#, &weighs] {
        let said = read(&quadruped("", needed, "", "")).err().unwrap();
        assert!(said.contains("shell.obj") && said.lines().count() == 1, "{said}");
    }
    let massless = in_calf(r#"contype="0" conaffinity="0" mass="0"/><geom type="sphere" size="0.01" mass="0.1""#);
    assert!(read(&quadruped("", &massless, "", "")).is_ok());
}

/// MuJoCo lets the geoms of a `<pair>` collide whatever their `contype`. So feet with `contype` 0 touch the ground if
/// pairs with the floor name them; without these pairs the robot is refused.
#[test]
fn geoms_of_a_pair_touch_the_ground() {
    let silent = r#"contype="0" conaffinity="0""#;
    let refused = read(&quadruped(silent, "", "", "")).unwrap().check_legged();
    assert!(refused.is_err());
    let floor = r#"<geom name="floor" type="plane" size="1 1 1"/>"#;
    let pairs: String =
        ["FL", "FR", "RL", "RR"].map(|leg| format!(r#"<pair geom1="floor" geom2="{leg}_foot"/>"#)).concat();
    let import = read(&quadruped(silent, "", floor, &format!("<contact>{pairs}</contact>"))).unwrap();
    import.check_legged().unwrap();
    assert_eq!(import.stance.legs.len(), 4);
}

/// A keyframe in which the knees are bent beyond their stops is no standing pose; one that is rounded is.
#[test]
fn a_pose_outside_of_the_ranges_is_found_anew() {
    let key = |knee: f64| {
        let pose = format!("1.3 {knee} ").repeat(4);
        quadruped("", "", "", &format!(r#"<keyframe><key name="home" qpos="0 0 0.2 1 0 0 0 {pose}"/></keyframe>"#))
    };
    let rounded = read(&key(-2.6005)).unwrap();
    assert_eq!(rounded.stance.angles[1], -2.6005);
    let import = read(&key(-2.7)).unwrap();
    assert!(import.stance.angles.iter().skip(1).step_by(2).all(|q| (-2.6..-0.3).contains(q)), "{:?}", import.stance);
    assert!(import.warnings.iter().any(|w| w.contains("within their ranges")), "{:?}", import.warnings);
}

/// A pose that the user lays over stays, with a warning that names the joints outside of their ranges.
#[test]
fn a_pose_laid_over_outside_of_the_ranges_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &quadruped("", "", "", ""));
    let warned = |knee: f64| {
        let angles = [("FL_knee".to_owned(), knee), ("hip".to_owned(), 1.0)];
        let posture = Posture { default_joint_angles: BTreeMap::from(angles), ..Posture::default() };
        let import = robots::load_with(&path, &posture).unwrap();
        assert_eq!(import.stance.angles[1], knee);
        import.warnings.iter().any(|w| w.contains("FL_knee") && w.contains("outside of its range"))
    };
    assert!(warned(-2.7) && !warned(-1.5));
}

/// The legs have no hip joints to the side, and their feet are 5 cm beside the hips' axes. The computed pose bends the
/// knees, and the robot stands.
#[test]
fn legs_that_move_in_a_plane_stand_on_bent_knees() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &quadruped("", "", "", ""));
    let stance = robots::load(&path).unwrap().stance;
    assert!((0.2..0.35).contains(&stance.leg_length), "{stance:?}");
    assert!(stance.angles.iter().skip(1).step_by(2).all(|knee| *knee < -0.8), "{stance:?}");
    let found = falls(&path);
    assert_eq!(found.len(), 2);
    assert!(found.iter().all(|(_, reason)| reason.is_empty()), "{found:?}");
}

/// A robot on two flat feet, whose trunk is longer than its legs, as MJCF. It has ankles that roll. With a waist, the trunk
/// turns on the pelvis about `waist`, and the pelvis carries the legs.
fn biped(waist: Option<&str>) -> String {
    let mut legs = String::new();
    for (name, y) in [("L", 0.1), ("R", -0.1)] {
        let link = |mass: f64| format!(r#"<inertial pos="0 0 -0.15" mass="{mass}" diaginertia="0.02 0.02 0.005"/>"#);
        let hinge = |part: &str, axis: &str, range: &str| {
            format!(r#"<joint name="{name}_{part}" axis="{axis}" range="{range}" limited="true"/>"#)
        };
        legs += &format!(
            r#"<body name="{name}_hip" pos="0 {y} 0"><inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>{}
              <body name="{name}_thigh">{}{}<body name="{name}_shank" pos="0 0 -0.35">{}{}
                <body name="{name}_cross" pos="0 0 -0.35"><inertial pos="0 0 0" mass="0.2" diaginertia="2e-4 2e-4 2e-4"/>{}
                  <body name="{name}_sole"><inertial pos="0.03 0 -0.04" mass="0.8" diaginertia="1e-3 3e-3 3e-3"/>{}
                    <geom type="box" size="0.11 0.045 0.015" pos="0.03 0 -0.05"/></body></body></body></body></body>"#,
            hinge("hip_roll", "1 0 0", "-0.5 0.5"),
            link(3.0),
            hinge("hip_pitch", "0 1 0", "-2 1"),
            link(2.0),
            hinge("knee", "0 1 0", "0 2.2"),
            hinge("ankle_pitch", "0 1 0", "-0.9 0.6"),
            hinge("ankle_roll", "1 0 0", "-0.3 0.3"),
        );
    }
    let carried = waist.map_or_else(
        || legs.clone(),
        |axis| {
            format!(
                r#"<body name="pelvis"><inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
                  <joint name="waist" axis="{axis}" range="-2.6 2.6" limited="true"/>{legs}</body>"#
            )
        },
    );
    format!(
        r#"<mujoco model="biped"><compiler angle="radian"/><worldbody><body name="trunk" pos="0 0 0.8"><freejoint/>
          <inertial pos="0 0 0.6" mass="25" diaginertia="2.2 2.1 0.3"/><geom type="box" size="0.1 0.15 0.6" pos="0 0 0.6"/>
          {carried}</body></worldbody></mujoco>"#
    )
}

/// All joints of two legs bend, and only found gains hold the robot upright on hard ground.
#[test]
fn a_robot_on_two_legs_stands_upright() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path(), &biped(None));
    assert_eq!(falls(&path)[0], ("rigid".to_owned(), String::new()));
}

/// The search bends the legs, not the waist that carries both.
#[test]
fn legs_on_one_waist_stand_alike() {
    for axis in ["1 0 0", "0 1 0", "0 0 1"] {
        let import = read(&biped(Some(axis))).unwrap();
        let angles = &import.stance.angles;
        assert_eq!((import.stance.legs.len(), angles.len(), angles[0]), (2, 11, 0.0), "{axis}");
        // The pitch of hip, knee and ankle.
        assert!([2, 3, 4].iter().all(|k| (angles[*k] - angles[k + 5]).abs() < 0.02), "{axis}: {angles:?}");
        assert!(angles[3] > 0.2, "{axis}: {angles:?}");
    }
}

/// A lower leg with a wide shell at the knee, whose knee turns both ways: the leg stands on its foot, not on the shell.
#[test]
fn legs_stand_on_their_feet_not_on_their_knees() {
    let shell = r#"<geom type="box" size="0.06 0.03 0.03" pos="0.05 0 0.01"/><geom name="FL_foot""#;
    let text = quadruped("", "", "", "").replace("-2.6 -0.3", "-2.8 2.8").replace("-2 2", "-2.8 2.8");
    let mut text = text
        .replace(r#"pos="0 0.02 -0.2""#, r#"pos="0.08 0.02 -0.25""#)
        .replace(r#"pos="0 -0.02 -0.2""#, r#"pos="0.08 -0.02 -0.25""#);
    for leg in ["FL", "FR", "RL", "RR"] {
        let foot = format!(r#"<geom name="{leg}_foot""#);
        text = text.replace(&foot, &shell.replace("FL", leg));
    }
    let stance = read(&text).unwrap().stance;
    // The foot is below the knee if the lower leg, whose foot is at (0.08, -0.25), is turned by less than a right angle.
    for (hip, knee) in stance.angles.iter().step_by(2).zip(stance.angles.iter().skip(1).step_by(2)) {
        assert!((hip + knee).cos() > 0.5, "{:?}", stance.angles);
    }
    assert!(stance.leg_length > 0.25, "{stance:?}");
}

/// Two legs as MJCF. `parts` are the joints of a leg from the trunk outward: its name, its axis, and how far it is below the
/// one before it. A foot 0.05 m high hangs on the last joint.
fn legs_of(parts: &[(&str, &str, f64)]) -> String {
    let leg = |side: &str, y: f64| {
        let mut text = String::new();
        for (k, (name, axis, below)) in parts.iter().enumerate() {
            let y = if k == 0 { y } else { 0.0 };
            text += &format!(
                r#"<body name="{side}_{name}" pos="0 {y} {}"><joint name="{side}_{name}" axis="{axis}" range="-1 1.5"/>
                <inertial pos="0 0 -0.05" mass="1" diaginertia="0.01 0.01 0.01"/>"#,
                -below
            );
        }
        text + r#"<geom type="box" size="0.1 0.04 0.02" pos="0.04 0 -0.03"/>"# + &"</body>".repeat(parts.len())
    };
    let zeros = "0 ".repeat(2 * parts.len());
    format!(
        r#"<mujoco><compiler angle="radian"/><worldbody><body name="pelvis" pos="0 0 0.8"><freejoint/>
          <geom type="box" size="0.08 0.12 0.07" mass="10"/>{}{}</body></worldbody>
          <keyframe><key name="home" qpos="0 0 0.8 1 0 0 0 {zeros}"/></keyframe></mujoco>"#,
        leg("L", 0.1),
        leg("R", -0.1)
    )
}

/// A leg is as long as from its hip to its sole, also where joints divide the thigh (Unitree's G1, Booster's T1) or the thigh is
/// much shorter than the shank; the base's frame stays where the file has it.
#[test]
fn legs_begin_at_their_hips() {
    let divided = [
        ("pitch", "0 1 0", 0.07),
        ("roll", "1 0 0", 0.03),
        ("yaw", "0 0 1", 0.15),
        ("knee", "0 1 0", 0.18),
        ("ankle", "0 1 0", 0.31),
    ];
    let short = [
        ("yaw", "0 0 1", 0.07),
        ("roll", "1 0 0", 0.0),
        ("pitch", "0 1 0", 0.02),
        ("knee", "0 1 0", 0.11),
        ("ankle", "0 1 0", 0.33),
        ("ankle_roll", "1 0 0", 0.0),
    ];
    for (parts, length) in [(&divided[..], 0.03 + 0.15 + 0.18 + 0.31 + 0.05), (&short[..], 0.11 + 0.33 + 0.05)] {
        let import = read(&legs_of(parts)).unwrap();
        assert_eq!(import.stance.legs.len(), 2);
        assert!((import.stance.leg_length - length).abs() < 1e-3, "{} {length}", import.stance.leg_length);
        assert!(import.warnings.iter().all(|w| !w.contains("root's frame")), "{:?}", import.warnings);
        // Without the file's pose each foot stands under its thigh, and the robot is nearly upright.
        let text = legs_of(parts);
        let (before, after) =
            (text.find("<keyframe>").unwrap(), "</keyframe>".len() + text.find("</keyframe>").unwrap());
        let found = read(&(text[..before].to_owned() + &text[after..])).unwrap().stance;
        assert!((0.8 * length..length).contains(&found.leg_length), "{found:?}");
    }
}

/// A keyframe with an arm's joint, or slightly with a leg's, outside of its range is the standing pose, at the ranges' ends.
#[test]
fn a_pose_slightly_outside_of_the_ranges_is_kept() {
    let key = |knee: f64, thumb: f64| {
        let inertial = r#"<inertial pos="0.1 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>"#;
        let arm = format!(
            r#"<body pos="0.3 0 0">{inertial}<joint name="thumb" axis="0 1 0" range="-1 1" limited="true"/></body>"#
        );
        let pose = format!("0.15 {knee} ") + &"0.15 -0.3 ".repeat(3);
        let key = format!(r#"<keyframe><key qpos="0 0 0.3 1 0 0 0 {thumb} {pose}"/></keyframe>"#);
        read(&quadruped("", &arm, "", &key)).unwrap()
    };
    for (knee, thumb, named) in
        [(-0.3, 1.05, Some("thumb")), (-0.3, 1.9, Some("thumb")), (-0.27, 0.0, Some("FL_knee")), (-0.3, 0.0, None)]
    {
        let import = key(knee, thumb);
        assert_eq!(import.stance.angles[..3], [thumb.min(1.0), 0.15, knee.min(-0.3)], "{:?}", import.warnings);
        let said = import.warnings.iter().find(|w| w.contains("at the end of its range"));
        assert_eq!(said.is_some(), named.is_some(), "{:?}", import.warnings);
        assert!(named.is_none_or(|name| said.unwrap().contains(name)), "{said:?}");
    }
}
