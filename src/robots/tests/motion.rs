//! Numbers of files that change the motion: servos as MuJoCo compiles them, gravity, held weights, lags, frames of the base
//! outside of the body, limits a turn away, and joints that follow others.

use nalgebra::Vector3;
use sandgait_robots::{Import, load};
use sandgait_sand::Medium;
use sandgait_sim::engine::{Command, Engine, EngineKind};
use sandgait_sim::model::Scene;
use sandgait_sim::tree::{HardGround, TreeModel, standing};
use sandgait_sim::{Model, State};
use std::f64::consts::TAU;
use std::path::Path;

fn read(name: &str, text: &str) -> Import {
    let root = tempfile::tempdir().unwrap();
    std::fs::write(root.path().join(name), text).unwrap();
    load(&root.path().join(name)).unwrap()
}

/// kp and kd of each servo equal those that MuJoCo 4 compiles, on a free base and on one that is fixed to the world: nested
/// classes, `dampratio`, `kv`, gears, armatures of actuators, a reference pose, and damping ratios in `biasprm`.
#[test]
fn servos_are_those_of_mujoco() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/robots");
    let text = std::fs::read_to_string(data.join("servos.xml")).unwrap();
    let wanted = std::fs::read_to_string(data.join("servos.json")).unwrap();
    let wanted: serde_json::Value = serde_json::from_str(&wanted).unwrap();
    for (key, text) in [("free", text.clone()), ("fixed", text.replace("<freejoint/>", ""))] {
        let import = read("servos.xml", &text);
        for row in wanted[key].as_array().unwrap() {
            let joint = import.tree.joints().find(|j| row["joint"] == j.name.as_str()).unwrap();
            let [kp, kd] = ["kp", "kd"].map(|name| row[name].as_f64().unwrap());
            if kp > 0.0 || kd > 0.0 {
                let (own_kp, own_kd) = (joint.kp.unwrap(), joint.kd.unwrap());
                assert!((own_kp - kp).abs() <= 1e-9 * kp.max(1.0), "{key} {}: kp {own_kp} {kp}", joint.name);
                assert!((own_kd - kd).abs() <= 1e-6 * kd, "{key} {}: kd {own_kd} {kd}", joint.name);
            }
        }
        let lag = import.tree.joints().find(|j| j.name == "FL_pitch").unwrap().target_time;
        assert_eq!(lag, Some(0.03));
        assert!(import.warnings.iter().all(|w| !w.contains("not simulated")), "{:?}", import.warnings);
    }
}

/// A quadruped as URDF. `below`: how far the root's frame is below the trunk; `bare`: as a link without mass, or in the trunk
/// itself; `turns`: whole turns by which the knees' range is away; `tail`: links and joints of a tail.
fn urdf(below: f64, bare: bool, turns: f64, tail: &str) -> String {
    let inertial = |mass: f64, z: f64, i: f64| {
        format!(
            r#"<inertial><origin xyz="0 0 {z}"/><mass value="{mass}"/><inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>"#
        )
    };
    let up = if bare { 0.0 } else { below };
    let mut text = r#"<robot name="cat">"#.to_owned();
    if below > 0.0 && bare {
        text += &format!(
            r#"<link name="base_footprint"/><joint name="up" type="fixed"><parent link="base_footprint"/><child link="trunk"/><origin xyz="0 0 {below}"/></joint>"#
        );
    }
    text += &format!(
        r#"<link name="trunk">{}<collision><origin xyz="0 0 {up}"/><geometry><box size="0.4 0.16 0.1"/></geometry></collision></link>"#,
        inertial(7.0, up, 0.1)
    );
    for (name, x, y) in [("FL", 0.2, 0.1), ("FR", 0.2, -0.1), ("RL", -0.2, 0.1), ("RR", -0.2, -0.1)] {
        let [low, high] = [-2.6, -0.4].map(|end| end + turns * TAU);
        text += &format!(
            r#"<link name="{name}_thigh">{}</link><link name="{name}_calf">{}<collision><origin xyz="0 0 -0.2"/><geometry><sphere radius="0.02"/></geometry></collision></link>
            <joint name="{name}_hip" type="revolute"><parent link="trunk"/><child link="{name}_thigh"/><origin xyz="{x} {y} {up}"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="30" velocity="20"/></joint>
            <joint name="{name}_knee" type="revolute"><parent link="{name}_thigh"/><child link="{name}_calf"/><origin xyz="0 0 -0.2"/><axis xyz="0 1 0"/><limit lower="{low}" upper="{high}" effort="30" velocity="20"/></joint>"#,
            inertial(0.5, -0.1, 1e-3),
            inertial(0.2, -0.1, 5e-4)
        );
    }
    text + tail + "</robot>"
}

fn model(import: &Import, dt: f64) -> Model {
    let plates = vec![Vec::new(); import.tree.bodies.len()];
    let scene =
        Scene { dt, hard: vec![HardGround::everywhere()], ..Scene::flat(Medium::named(Medium::DEFAULT).unwrap()) };
    Model::of_tree(TreeModel::new(import.tree.clone(), plates).unwrap(), &scene).unwrap()
}

/// A root's frame on the ground, as a link without mass or as the trunk's own frame, changes neither the motion nor
/// what the check finds. With a link without mass the results are equal to the last bit.
#[test]
fn the_roots_frame_does_not_matter() {
    let plain = read("r.urdf", &urdf(0.0, true, 0.0, ""));
    assert!(plain.warnings.is_empty(), "{:?}", plain.warnings);
    let own = standing::stand(&model(&plain, 2e-3)).unwrap();
    assert!(own.stands, "{}", own.reason);
    let needed = |import: &Import| standing::needed_step(|dt| Ok(model(import, dt))).unwrap();
    for (below, bare) in [(0.3, true), (0.7, true), (0.3, false), (0.25, false)] {
        let import = read("r.urdf", &urdf(below, bare, 0.0, ""));
        assert!(import.warnings[0].contains("root's frame"), "{:?}", import.warnings);
        let found = standing::stand(&model(&import, 2e-3)).unwrap();
        assert!(found.stands, "{below} {bare}: {}", found.reason);
        let off = (found.height[0] - own.height[0]).abs();
        assert!(off <= if bare { 0.0 } else { 1e-4 }, "{below} {bare}: {:?} {:?}", found.height, own.height);
        if bare {
            assert_eq!(found.state, own.state);
        }
        assert_eq!(needed(&import), needed(&plain), "{below} {bare}");
        // For other programs, the frame is the file's.
        let file = import.as_in_file();
        assert!((file.bodies[0].center - Vector3::new(0.0, 0.0, below)).norm() < 1e-12);
    }
}

/// A root's frame may be turned: a robot whose front is along y, or anywhere, stands with its knees bent all the same.
#[test]
fn the_roots_direction_does_not_matter() {
    let plain = include_str!("../../../robots/sandcat.urdf");
    let angles = |yaw: f64| {
        let root = format!(
            r#"<link name="turned"/><joint name="turn" type="fixed"><parent link="turned"/><child link="trunk"/><origin xyz="0 0 0" rpy="0 0 {yaw}"/></joint></robot>"#
        );
        read("r.urdf", &plain.replace("</robot>", &root)).stance.angles
    };
    let own = angles(0.0);
    assert!(own[2] < -1.0, "{own:?}");
    for degrees in [80.0_f64, 90.0, -90.0, 91.0, 180.0] {
        let found = angles(degrees.to_radians());
        let off = found.iter().zip(&own).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-3, "{degrees}: {found:?} {own:?}");
    }
}

/// A robot that a fast motion of its joints throws over says nothing of the time step that it needs. It moves less then, and the
/// step does not change with a little more stiffness or less weight.
#[test]
fn the_needed_step_is_no_accident() {
    let mut legs = String::new();
    for (name, x, y) in [("a", 0.15, 0.1), ("b", 0.15, -0.1), ("c", -0.15, 0.1), ("d", -0.15, -0.1)] {
        legs += &format!(
            r#"<body pos="{x} {y} 0"><joint name="{name}_hip" axis="0 1 0" range="-60 60"/>
            <geom type="capsule" fromto="0 0 0 0 0 -.15" size=".015" mass=".2"/><body pos="0 0 -.15">
            <joint name="{name}_knee" axis="0 1 0" range="-120 0"/><geom type="capsule" fromto="0 0 0 0 0 -.15" size=".012" mass=".1"/></body></body>"#
        );
    }
    let joints = ["a", "b", "c", "d"].iter().flat_map(|leg| ["hip", "knee"].map(|joint| format!("{leg}_{joint}")));
    let joints: Vec<String> = joints.collect();
    let robot = |kp: f64, gravity: f64| {
        let motor = |joint: &String| format!(r#"<position joint="{joint}" kp="{kp}" dampratio="1"/>"#);
        let motors: String = joints.iter().map(motor).collect();
        let pose = "0.6 -1.2 ".repeat(4);
        read(
            "r.xml",
            &format!(
                r#"<mujoco><option gravity="0 0 -{gravity}"/><worldbody><body><freejoint/><geom type="box" size=".2 .1 .04" mass="3"/>{legs}</body></worldbody>
                <actuator>{motors}</actuator><keyframe><key name="home" qpos="0 0 .26 1 0 0 0 {pose}"/></keyframe></mujoco>"#
            ),
        )
    };
    let needed = |import: Import| standing::needed_step(|dt| Ok(model(&import, dt))).unwrap();
    let own = needed(robot(60.0, 9.81));
    assert!(own.is_some());
    for (kp, gravity) in [(72.0, 9.81), (60.0, 5.0)] {
        assert_eq!(needed(robot(kp, gravity)), own, "{kp} {gravity}");
    }
}

/// A root's frame far beside the body is replaced, too, and of two frames below the body the one in it is taken.
#[test]
fn the_base_is_in_the_body() {
    let plain = urdf(0.0, true, 0.0, "");
    let rooted = |frames: &[(&str, [f64; 3])]| {
        let mut links = String::new();
        for (k, (name, [x, y, z])) in frames.iter().enumerate() {
            let child = frames.get(k + 1).map_or("trunk", |next| next.0);
            links += &format!(
                r#"<link name="{name}"/><joint name="to_{child}" type="fixed"><parent link="{name}"/><child link="{child}"/><origin xyz="{x} {y} {z}"/></joint>"#
            );
        }
        read("r.urdf", &plain.replace(r#"<link name="trunk">"#, &(links + r#"<link name="trunk">"#)))
    };
    for frames in [
        &[("ahead", [-0.7, 0.0, 0.0])][..],
        &[("beside", [0.0, 0.6, 0.1])],
        &[("base_footprint", [0.0, 0.0, 0.25]), ("base_link", [0.0, 0.0, 0.1])],
    ] {
        let import = rooted(frames);
        assert!(import.warnings[0].contains("root's frame"), "{frames:?}: {:?}", import.warnings);
        assert_eq!(import.tree.bodies[0].center, Vector3::zeros(), "{frames:?}");
    }
    let near = rooted(&[("base", [-0.2, 0.0, 0.0])]);
    assert!(near.warnings.is_empty(), "{:?}", near.warnings);
}

/// The standing pose is found inside of ranges that are whole turns away: the same pose, turned.
#[test]
fn a_pose_is_found_within_ranges_a_turn_away() {
    let plain = read("r.urdf", &urdf(0.0, true, 0.0, ""));
    for turns in [-1.0, 1.0, 2.0] {
        let import = read("r.urdf", &urdf(0.0, true, turns, ""));
        assert!(import.warnings.is_empty(), "{:?}", import.warnings);
        for (k, (a, b)) in plain.stance.angles.iter().zip(&import.stance.angles).enumerate() {
            let away = if k % 2 == 1 { turns * TAU } else { 0.0 };
            assert!((b - away - a).abs() < 1e-6, "{turns}: joint {k}, {a} {b}");
        }
        assert!(standing::stand(&model(&import, 2e-3)).unwrap().stands);
    }
}

/// A tail of `links` links of `mass`; each joint after the first follows the first with `ratio`; `effort` of all.
fn tail(links: usize, mass: f64, ratio: f64, effort: f64) -> String {
    let inertia = 2e-4 * mass;
    let mut text = String::new();
    for k in 0..links {
        let parent = if k == 0 { "trunk".into() } else { format!("tail{}", k - 1) };
        let mimic =
            if k == 0 { String::new() } else { format!(r#"<mimic joint="wag0" multiplier="{ratio}" offset="0.1"/>"#) };
        text += &format!(
            r#"<link name="tail{k}"><inertial><origin xyz="-0.025 0 0"/><mass value="{mass}"/><inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="wag{k}" type="revolute"><parent link="{parent}"/><child link="tail{k}"/><origin xyz="-0.05 0 0"/><axis xyz="0 1 0"/>
            <limit lower="-1.5" upper="1.5" effort="{effort}" velocity="0"/>{mimic}</joint>"#
        );
    }
    text
}

/// No follower diverges at the default time step, however light its link and whatever its ratio and effort; each stays on
/// its line.
#[test]
fn followers_do_not_diverge() {
    for (links, mass, ratio, effort) in [
        (2, 0.05, 1.0, 0.0),
        (2, 0.05, 1.0, 1000.0),
        (2, 0.005, 1.0, 0.0),
        (3, 0.02, -1.0, 0.0),
        (4, 0.01, 2.0, 0.0),
        (3, 0.05, -3.0, 0.0),
        (2, 1.0, 0.5, 0.0),
        (5, 0.002, 0.3, 0.0),
    ] {
        let import = read("r.urdf", &urdf(0.0, true, 0.0, &tail(links, mass, ratio, effort)));
        let what = format!("{links} {mass} {ratio} {effort}");
        assert_eq!(import.needed_step().unwrap(), None, "{what}");
        let model = model(&import, 2e-3);
        let mut engine = Engine::new(EngineKind::Tree, &model, 1).unwrap();
        let tree = model.tree.clone().unwrap();
        let mut state = State::at_rest(tree.standing_height(&tree.stance.angles), &tree.stance.angles);
        engine.set_state(0, &state);
        let mut command = Command::still(model.joints());
        let names = model.joint_names();
        let at = |name: &str| names.iter().position(|n| n == name).unwrap();
        let mut farthest = 0.0_f64;
        for k in 0..200 {
            command.targets = tree.stance.angles.clone();
            command.targets[at("wag0")] += 0.3 * (TAU * f64::from(k) / 50.0).sin();
            engine.command(0, &command);
            engine.advance(10);
            engine.state(0, &mut state);
            assert!(state.is_sound(), "{what}");
            for follower in (1..links).filter(|_| k > 10) {
                let off = state.angles[at(&format!("wag{follower}"))] - 0.1 - ratio * state.angles[at("wag0")];
                farthest = farthest.max(off.abs());
            }
        }
        // Ratios above 2 lead beyond the followers' stops.
        assert!(farthest < 0.05 || ratio.abs() > 2.0, "{what}: {farthest}");
    }
}

/// The torque of a follower acts back on its leader: a gear of two equal pendulums holds both up with one motor.
#[test]
fn followers_load_their_leaders() {
    let hanging = |ratio: f64| {
        let text = urdf(0.0, true, 0.0, "").replace("</robot>", "")
            + &tail(1, 0.5, 1.0, 0.0)
            + &tail(1, 0.5, 1.0, 0.0)
                .replace("tail0", "fin")
                .replace("wag0", "flap")
                .replace("-0.05 0 0", "-0.05 0.2 0")
                .replace("</joint>", &format!(r#"<mimic joint="wag0" multiplier="{ratio}"/></joint>"#))
            + "</robot>";
        let import = read("r.urdf", &text);
        let found = standing::stand(&model(&import, 2e-3)).unwrap();
        assert!(found.stands, "{}", found.reason);
        let names: Vec<String> = import.tree.joints().map(|j| j.name.clone()).collect();
        let torque = |name: &str| found.state.torques[names.iter().position(|n| n == name).unwrap()];
        [torque("wag0"), torque("flap")]
    };
    let weight = 0.5 * 9.80665 * 0.025;
    let [leader, follower] = hanging(1.0);
    assert!((follower.abs() / weight - 1.0).abs() < 0.1, "{follower} {weight}");
    assert!((leader.abs() / (2.0 * weight) - 1.0).abs() < 0.1, "{leader} {weight}");
    // With the ratio −1 the two balance each other.
    let [leader, _] = hanging(-1.0);
    assert!(leader.abs() < 0.2 * weight, "{leader}");
}

fn mjcf(option: &str, trunk: &str, leg: &str) -> String {
    let mut legs = String::new();
    for (name, x, y) in [("FL", 0.2, 0.1), ("FR", 0.2, -0.1), ("RL", -0.2, 0.1), ("RR", -0.2, -0.1)] {
        legs += &format!(
            r#"<body name="{name}_thigh" pos="{x} {y} 0"><inertial pos="0 0 -0.1" mass="0.4" diaginertia="1e-3 1e-3 1e-3"/><joint name="{name}_hip" axis="0 1 0" range="-2 2"/>
            <body name="{name}_calf" pos="0 0 -0.2"><inertial pos="0 0 -0.1" mass="0.1" diaginertia="3e-4 3e-4 1e-4"/><joint name="{name}_knee" axis="0 1 0" range="-2.6 -0.3"/>
            <geom type="sphere" size="0.02" pos="0 0 -0.2"/></body></body>"#
        );
    }
    let servos: String = ["FL", "FR", "RL", "RR"]
        .iter()
        .flat_map(|l| ["hip", "knee"].map(|j| format!(r#"<position joint="{l}_{j}" kp="80" kv="2" {leg}/>"#)))
        .collect();
    format!(
        r#"<mujoco model="own"><compiler angle="radian"/>{option}<worldbody><body name="base" pos="0 0 0.3" {trunk}><freejoint/>
        <inertial pos="0 0 0" mass="7" diaginertia="0.1 0.1 0.1"/><geom type="box" size="0.2 0.08 0.05"/>{legs}</body></worldbody>
        <actuator>{servos}</actuator></mujoco>"#
    )
}

fn load_of_feet(import: &Import) -> f64 {
    let found = standing::stand(&model(import, 2e-3)).unwrap();
    assert!(found.stands, "{}", found.reason);
    found.feet.iter().map(|f| f.load).sum()
}

/// The file's gravity is that of the simulation: weights, and the forces of feet.
#[test]
fn gravity_is_that_of_the_file() {
    let mass = 9.0;
    let earth = read("r.xml", &mjcf(r#"<option gravity="0 0 -9.81"/>"#, "", ""));
    assert_eq!(earth.tree.gravity, None);
    let moon = read("r.xml", &mjcf(r#"<option gravity="0 0 -1.62"/>"#, "", ""));
    assert_eq!(moon.tree.gravity, Some(1.62));
    assert!(moon.warnings.iter().any(|w| w.contains("1.62")), "{:?}", moon.warnings);
    assert!((load_of_feet(&earth) / (mass * 9.80665) - 1.0).abs() < 0.02);
    assert!((load_of_feet(&moon) / (mass * 1.62) - 1.0).abs() < 0.02);
    assert!((model(&moon, 2e-3).weight() / (mass * 1.62) - 1.0).abs() < 1e-12);
    let sand = model(&moon, 2e-3).sand().coefficients.a00 / model(&earth, 2e-3).sand().coefficients.a00;
    assert!((sand - 1.62 / 9.80665).abs() < 1e-12, "{sand}");
    for wrong in [
        r#"<option gravity="0 0 0"/>"#,
        r#"<option gravity="0 0 9.81"/>"#,
        r#"<option gravity="1 0 -9.81"/>"#,
        r#"<option><flag gravity="disable"/></option>"#,
    ] {
        let root = tempfile::tempdir().unwrap();
        std::fs::write(root.path().join("r.xml"), mjcf(wrong, "", "")).unwrap();
        let said = load(&root.path().join("r.xml")).err().unwrap().to_string();
        assert!(said.contains("gravity") && said.contains("line"), "{wrong}: {said}");
    }
}

/// `gravcomp` holds the weight of a body, and not its inertia.
#[test]
fn held_bodies_weigh_nothing() {
    let import = read("r.xml", &mjcf("", r#"gravcomp="1""#, ""));
    assert_eq!(import.tree.bodies[0].held.mass, 7.0);
    assert!((load_of_feet(&import) / (2.0 * 9.80665) - 1.0).abs() < 0.03);
    assert!((model(&import, 2e-3).weight() / (2.0 * 9.80665) - 1.0).abs() < 1e-12);
    let half = read("r.xml", &mjcf("", r#"gravcomp="0.5""#, ""));
    assert!((load_of_feet(&half) / (5.5 * 9.80665) - 1.0).abs() < 0.03);
}

/// The reference of a servo with `timeconst` follows its target as MuJoCo's exact filter does.
#[test]
fn targets_with_a_time_constant_lag() {
    let import = read("r.xml", &mjcf("", "", r#"timeconst="0.05""#));
    let model = model(&import, 2e-3);
    let mut engine = Engine::new(EngineKind::Tree, &model, 1).unwrap();
    let mut state = State::at_rest(1.0, &import.stance.angles);
    engine.set_state(0, &state);
    let mut command = Command::still(model.joints());
    command.targets = import.stance.angles.iter().map(|q| q + 0.2).collect();
    for k in 1..=5 {
        engine.command(0, &command);
        engine.advance(10);
        engine.state(0, &mut state);
        let part = (state.references[0] - import.stance.angles[0]) / 0.2;
        let wanted = 1.0 - (-0.02 * f64::from(k) / 0.05).exp();
        assert!((part - wanted).abs() < 1e-4, "{k}: {part} {wanted}");
    }
}

/// Small balls at the corners of a sole touch sand as one sole, with a line that says so; single balls and balls that touch
/// do not.
#[test]
fn small_balls_are_one_sole() {
    let feet = |balls: &[[f64; 4]]| {
        let shapes: String = balls
            .iter()
            .map(|[x, y, z, r]| {
                format!(
                    r#"<collision><origin xyz="{x} {y} {z}"/><geometry><sphere radius="{r}"/></geometry></collision>"#
                )
            })
            .collect();
        let one = r#"<collision><origin xyz="0 0 -0.2"/><geometry><sphere radius="0.02"/></geometry></collision>"#;
        read("r.urdf", &urdf(0.0, true, 0.0, "").replace(one, &shapes))
    };
    let area = |import: &Import| {
        let shapes = import.touching(None).unwrap();
        let plates = sandgait_sim::tree::of_touching(&import.on_soles(), &shapes, None).unwrap();
        plates[2].iter().map(|p| p.area).sum::<f64>()
    };
    let sole =
        [[0.1, 0.03, -0.2, 0.005], [0.1, -0.03, -0.2, 0.005], [-0.05, 0.03, -0.2, 0.005], [-0.05, -0.03, -0.2, 0.005]];
    let import = feet(&sole);
    assert!(import.warnings.iter().any(|w| w.contains("FL_calf") && w.contains("one sole")), "{:?}", import.warnings);
    // Both sides of a plate of 0.15 m × 0.06 m, and its edges.
    let wanted = 2.0 * 0.15 * 0.06;
    assert!((1.0..1.6).contains(&(area(&import) / wanted)), "{}", area(&import));
    assert_eq!(import.tree.bodies[2].shapes.len(), 4);
    for balls in [&sole[..2], &[[0.0, 0.0, -0.2, 0.02], [0.02, 0.0, -0.2, 0.02], [0.04, 0.0, -0.2, 0.02]]] {
        assert!(feet(balls).warnings.iter().all(|w| !w.contains("sole")));
    }
}
