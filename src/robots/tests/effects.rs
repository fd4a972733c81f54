//! What a file says that changes the motion: actuators as MuJoCo compiles them, and parts that are not simulated, which a
//! warning names with their effects; and what is said of files that are no robots.

use sandgait_robots::{Import, load};
use std::path::Path;

const SOLID: &str =
    r#"<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"#;

fn read(name: &str, text: impl AsRef<[u8]>) -> Result<Import, String> {
    let root = tempfile::tempdir().unwrap();
    std::fs::write(root.path().join(name), text).unwrap();
    load(&root.path().join(name)).map_err(|e| e.to_string())
}

/// A base and a leg; `inside` is in the joint, `beside` in the robot.
fn urdf(inside: &str, beside: &str) -> String {
    format!(
        r#"<robot name="r"><link name="base">{SOLID}</link><link name="leg">{SOLID}</link>
        <joint name="hip" type="revolute"><parent link="base"/><child link="leg"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/>{inside}</joint>{beside}</robot>"#
    )
}

/// The line of what is not simulated; empty: there is none.
fn not_simulated(import: &Import) -> &str {
    import.warnings.iter().find(|w| w.contains("is not simulated here")).map_or("", String::as_str)
}

/// Parts of Gazebo, MuJoCo and drake in a URDF are named with their effects; pictures and plugins are not.
#[test]
fn what_other_programs_read_in_a_urdf_is_named() {
    let gazebo = |inner: &str| format!(r#"<gazebo reference="leg">{inner}</gazebo>"#);
    let soft =
        r#"<safety_controller soft_lower_limit="-0.1" soft_upper_limit="0.1" k_position="100" k_velocity="10"/>"#;
    for (inside, beside, words) in [
        ("", gazebo("<turnGravityOff>true</turnGravityOff>"), "no weight"),
        ("", gazebo("<gravity>0</gravity>"), "no weight"),
        ("", gazebo("<springStiffness>20</springStiffness><springReference>1</springReference>"), "a spring"),
        (
            "",
            gazebo("<collision><surface><friction><ode><mu>0.2</mu></ode></friction></surface></collision>"),
            "friction",
        ),
        (
            "",
            r#"<gazebo><joint name="held" type="fixed"><parent>world</parent><child>leg</child></joint></gazebo>"#
                .into(),
            "joins the robot to other bodies",
        ),
        ("", r#"<mujoco><compiler balanceinertia="true"/></mujoco>"#.to_owned(), "inertias"),
        (soft, String::new(), "limits the joint"),
    ] {
        let import = read("r.urdf", urdf(inside, &beside)).unwrap();
        assert!(not_simulated(&import).contains(words), "{beside}: {:?}", import.warnings);
    }
    for harmless in [
        gazebo("<material>Gazebo/Red</material>"),
        gazebo("<turnGravityOff>false</turnGravityOff><springStiffness>0</springStiffness>"),
        gazebo(r#"<plugin name="p"><mu>1</mu></plugin>"#),
        r#"<mujoco><compiler balanceinertia="false" discardvisual="false"/></mujoco>"#.to_owned(),
    ] {
        let import = read("r.urdf", urdf("", &harmless)).unwrap();
        assert_eq!(not_simulated(&import), "", "{harmless}");
    }
}

/// MuJoCo takes gravity from the `<mujoco>` of a URDF.
#[test]
fn gravity_of_a_urdf_is_that_of_its_extension() {
    let of = |text: &str| read("r.urdf", urdf("", text));
    assert_eq!(of("").unwrap().tree.gravity, None);
    let moon = of(r#"<mujoco><option gravity="0 0 -1.62"/></mujoco>"#).unwrap();
    assert_eq!(moon.tree.gravity, Some(1.62));
    assert!(moon.warnings.iter().any(|w| w.contains("1.62")));
    assert!(of(r#"<mujoco><option gravity="0 0 0"/></mujoco>"#).err().unwrap().contains("gravity"));
}

/// One joint, called `knee`, with `attributes`; `base` is the base's joint.
fn mjcf(base: &str, attributes: &str, sections: &str) -> Import {
    let text = format!(
        r#"<mujoco><compiler angle="radian"/><worldbody><body>{base}<geom size="0.1"/>
        <body><joint name="knee" axis="0 1 0" range="-1 1" {attributes}/><geom size="0.02" pos="0 0 -0.2" mass="0.1"/>
        <body pos="0 0 -0.2"><joint name="ankle" axis="0 1 0" range="-1 1"/><geom size="0.02" pos="0 0 -0.1" mass="0.1"/></body>
        </body></body></worldbody>{sections}</mujoco>"#
    );
    read("r.xml", text).unwrap()
}

fn driven(actuators: &str) -> Import {
    mjcf("<freejoint/>", "", &format!("<actuator>{actuators}</actuator>"))
}

fn gains(import: &Import) -> [Option<f64>; 3] {
    let joint = import.tree.joints().find(|j| j.name == "knee").unwrap();
    [joint.kp, joint.kd, joint.torque_limit]
}

/// MuJoCo's force on a joint is that on the tendon times its coefficient, and the tendon's length the joint's position times it.
#[test]
fn servos_through_a_tendon_of_one_joint_drive_it() {
    let tendons = r#"<tendon><fixed name="one"><joint joint="knee" coef="-0.5"/></fixed>
        <fixed name="two"><joint joint="knee" coef="1"/><joint joint="ankle" coef="1"/></fixed></tendon>"#;
    let servo = |tendon: &str| {
        let act = format!(
            r#"<actuator><position tendon="{tendon}" kp="80" kv="2" gear="2" forcerange="-40 40"/></actuator>"#
        );
        mjcf("<freejoint/>", "", &(tendons.to_owned() + &act))
    };
    let import = servo("one");
    assert_eq!(gains(&import), [Some(80.0), Some(2.0), Some(40.0)]);
    assert_eq!(not_simulated(&import), "");
    assert!(import.warnings.iter().all(|w| !w.contains("<position> tendon")), "{:?}", import.warnings);
    let lever = mjcf(
        "<freejoint/>",
        "",
        &(tendons.to_owned() + r#"<actuator><position tendon="one" kp="80" kv="2" forcerange="-40 40"/></actuator>"#),
    );
    assert_eq!(gains(&lever), [Some(20.0), Some(0.5), Some(20.0)]);
    assert!(not_simulated(&servo("two")).contains("<position> on no single joint"));
}

/// A servo for the position and one for the speed of a joint are one servo; another second actuator is named.
#[test]
fn two_servos_of_a_joint_are_one() {
    let position = r#"<position joint="knee" kp="80" forcerange="-40 40"/>"#;
    let speed = r#"<velocity joint="knee" kv="2.5" forcerange="-10 10"/>"#;
    for order in [[position, speed], [speed, position]] {
        let import = driven(&order.concat());
        assert_eq!(gains(&import), [Some(80.0), Some(2.5), Some(50.0)]);
        assert_eq!(not_simulated(&import), "");
    }
    let limited =
        mjcf("<freejoint/>", r#"actuatorfrcrange="-30 30""#, &format!("<actuator>{position}{speed}</actuator>"));
    assert_eq!(gains(&limited), [Some(80.0), Some(2.5), Some(30.0)]);
    let motor = driven(&format!(r#"{position}<motor joint="knee"/>"#));
    assert_eq!(gains(&motor)[0], Some(80.0));
    assert!(not_simulated(&motor).contains("second actuators"));
}

/// What an actuator does in MuJoCo and not here is named with its effect; a plain servo has no warning.
#[test]
fn what_actuators_do_besides_is_named() {
    let general = |more: &str| format!(r#"<general joint="knee" gainprm="90" biastype="affine" {more}/>"#);
    for (actuator, words) in [
        (r#"<velocity joint="knee" kv="6"/>"#.to_owned(), "targets do not move it"),
        (general(r#"biasprm="5 -90 -3""#), "a constant force"),
        (general(r#"biasprm="0 -60 -3""#), "gain by bias"),
        (general(r#"biasprm="0 -90 -3" gaintype="affine""#), "changes with position"),
        (r#"<position joint="knee" kp="80" kv="2" ctrlrange="-0.1 0.1"/>"#.to_owned(), "targets within a part"),
        (r#"<position joint="knee" kp="80" kv="2" inheritrange="0.5"/>"#.to_owned(), "targets within a part"),
        (r#"<position joint="knee" kp="80" kv="2" forcerange="-5 30"/>"#.to_owned(), "different limits both ways"),
    ] {
        let import = driven(&actuator);
        assert!(import.warnings.iter().any(|w| w.contains(words)), "{actuator}: {:?}", import.warnings);
    }
    for plain in
        [general(r#"biasprm="0 -90 -3""#), r#"<position joint="knee" kp="80" kv="2" ctrlrange="-1 1"/>"#.to_owned()]
    {
        assert!(driven(&plain).warnings.is_empty(), "{:?}", driven(&plain).warnings);
    }
    let joint = mjcf("<freejoint/>", r#"actuatorfrcrange="-5 30""#, "");
    assert_eq!(gains(&joint)[2], Some(5.0));
    assert!(joint.warnings.iter().any(|w| w.contains("different limits both ways")), "{:?}", joint.warnings);
    let groups = mjcf("<freejoint/>", "", r#"<option actuatorgroupdisable="2"/>"#);
    assert!(not_simulated(&groups).contains("switched off"));
}

/// Damping and the like of a free joint, by itself or by a default class, act on the base; a `<freejoint>` has none.
#[test]
fn what_holds_a_free_base_is_named() {
    let class = r#"<default><joint damping="1" armature="0.1"/></default>"#;
    for (base, sections, words) in [
        (r#"<joint type="free" damping="5"/>"#, "", "drag on the base"),
        (r#"<joint type="free" stiffness="50"/>"#, "", "a spring pulls the base"),
        (r#"<joint type="free" frictionloss="3"/>"#, "", "friction holds the base"),
        (r#"<joint type="free"/>"#, class, "more inertia"),
    ] {
        let import = mjcf(base, "", sections);
        assert!(not_simulated(&import).contains(words), "{base}: {:?}", import.warnings);
    }
    for (base, sections) in [("<freejoint/>", class), (r#"<joint type="free" damping="0"/>"#, "")] {
        assert_eq!(not_simulated(&mjcf(base, "", sections)), "", "{base}");
    }
}

/// A description that is none gets its true reason and a remedy.
#[test]
fn files_that_are_no_robots_get_their_reasons() {
    let lfs = "version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 684\n";
    let open = urdf("", "").replace(r#"<mass value="1"/>"#, r#"<mass value="${mass}"/>"#);
    let macros =
        urdf("", r#"<xacro:leg name="a"/>"#).replace("<robot", r#"<robot xmlns:xacro="http://www.ros.org/wiki/xacro""#);
    for (name, text, words) in [
        ("r.urdf", lfs, "git lfs pull"),
        ("r.xml", lfs, "git lfs pull"),
        ("r.urdf", "404: Not Found", "server's answer"),
        ("r.urdf", "<!DOCTYPE html>\n<html></html>", "web page"),
        ("r.xml", "", "is empty"),
        ("r.urdf", " \n", "is empty"),
        ("r.urdf", &open, "run xacro"),
        ("r.urdf", &macros, "run xacro"),
        ("r.xacro", &macros, "run xacro"),
    ] {
        let said = read(name, text).err().unwrap_or_else(|| panic!("{text}"));
        assert!(said.contains(words) && said.lines().count() == 1, "{text}: {said}");
    }
    let declared = macros.replace(r#"<xacro:leg name="a"/>"#, "");
    for text in
        [declared, format!("<!DOCTYPE robot>\n{}", urdf("", "")), urdf("", "") + "\0", urdf("", "") + "\n\u{1a}"]
    {
        read("r.urdf", &text).unwrap_or_else(|e| panic!("{text}: {e}"));
    }
}

/// A mesh that is only drawn and cannot be read is one line with the file and the remedy, as in a URDF; other parts that are
/// not read are called by their names.
#[test]
fn meshes_of_mjcf_get_their_reasons() {
    let with = |asset: &str, geom: &str| {
        let base = format!(r#"<freejoint/><geom {geom}/>"#);
        let text = format!(
            r#"<mujoco><asset><mesh name="shell" {asset}/></asset><worldbody><body>{base}<geom size="0.1"/></body></worldbody></mujoco>"#
        );
        read("r.xml", text)
    };
    let drawn = r#"type="mesh" mesh="shell" mass="0" contype="0" conaffinity="0""#;
    for (asset, words) in [
        (r#"file="absent.stl""#, "absent.stl"),
        (r#"file="../../../elsewhere/shell.stl""#, "--packages"),
        (r#"builtin="sphere" params="2""#, "builtin"),
    ] {
        let import = with(asset, drawn).unwrap();
        let line = import.warnings.iter().find(|w| w.starts_with("1 visual is not drawn"));
        assert!(line.is_some_and(|line| line.contains(words)), "{asset}: {:?}", import.warnings);
    }
    let builtin = with(r#"builtin="sphere" params="2""#, r#"type="mesh" mesh="shell""#).err().unwrap();
    assert!(builtin.contains("builtin"), "{builtin}");
    let fitted = with(r#"vertex="0 0 0 1 0 0 0 1 0 0 0 1""#, r#"type="box" mesh="shell""#).err().unwrap();
    assert!(fitted.contains("fitted to a mesh"), "{fitted}");
}

/// The file's own name of a shape names it for `--touches`, unless two have it.
#[test]
fn shapes_are_named_as_in_the_file() {
    let import = mjcf("<freejoint/>", "", "");
    assert!(import.touching(Some(&["sole".to_owned()])).is_err());
    let text = r#"<mujoco><worldbody><body name="base"><freejoint/><geom name="belly" size="0.1"/>
        <body name="leg"><joint/><geom name="sole" size="0.1"/></body>
        <body name="arm"><joint/><geom name="palm" size="0.1"/><geom name="knob" size="0.1"/></body></body></worldbody></mujoco>"#;
    let import = read("r.xml", text).unwrap();
    for (name, wanted) in [("sole", (1, 0)), ("knob", (2, 1)), ("belly", (0, 0))] {
        assert_eq!(import.touching(Some(&[name.to_owned()])).unwrap(), [wanted], "{name}");
    }
    let twice =
        |name: &str| format!(r#"<collision name="{name}"><geometry><sphere radius="0.1"/></geometry></collision>"#);
    let text = urdf("", "").replace("</inertial>", &format!("</inertial>{}", twice("pad")));
    let said = read("r.urdf", text).unwrap().touching(Some(&["pad".to_owned()])).unwrap_err().to_string();
    assert!(said.contains("several") && said.contains("base"), "{said}");
}

/// A closed surface that is inside out is turned, not replaced by its hull; a size or a place does not matter. Blanks of a URI
/// are read.
#[test]
fn meshes_are_read_whatever_their_size_and_place() {
    let root = tempfile::tempdir().unwrap();
    // An L of two boxes, whose hull is larger.
    let corners = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]];
    let caps = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]];
    let solid = |inside_out: bool, size: f64, away: f64| {
        let mut text = String::new();
        for z in [0.0, 1.0] {
            for [x, y] in corners {
                text += &format!("v {} {} {}\n", size * f64::from(x) + away, size * f64::from(y), size * z);
            }
        }
        let mut faces: Vec<[usize; 3]> = Vec::new();
        for [a, b, c] in caps {
            faces.extend([[a, c, b], [a + 6, b + 6, c + 6]]);
        }
        for k in 0..6 {
            let next = (k + 1) % 6;
            faces.extend([[k, next, next + 6], [k, next + 6, k + 6]]);
        }
        for [a, b, c] in faces {
            let [b, c] = if inside_out { [c, b] } else { [b, c] };
            text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
        }
        text
    };
    let read = |name: &str| {
        let link = format!(r#"<collision><geometry><mesh filename="{name}"/></geometry></collision>"#);
        let text = format!(r#"<robot name="r"><link name="base">{SOLID}{link}</link></robot>"#);
        std::fs::write(root.path().join("r.urdf"), text).unwrap();
        let import = load(&root.path().join("r.urdf")).unwrap();
        let said = import.warnings.concat();
        assert!(!said.contains("convex hull"), "{name}: {said}");
        (said.contains("inside out"), import)
    };
    for (k, (inside_out, size, away)) in
        [(false, 1.0, 0.0), (true, 1.0, 0.0), (false, 1e-4, 0.0), (true, 1e-4, 50.0), (false, 1e-3, 50.0)]
            .iter()
            .enumerate()
    {
        let name = format!("l{k}.obj");
        std::fs::write(root.path().join(&name), solid(*inside_out, *size, *away)).unwrap();
        assert_eq!(read(&name).0, *inside_out, "{inside_out} {size} {away}");
    }
    std::fs::write(root.path().join("left leg.obj"), solid(false, 1.0, 0.0)).unwrap();
    assert!(Path::new(root.path()).join("left leg.obj").exists());
    assert_eq!(read("left%20leg.obj").1.tree.bodies[0].shapes.len(), 1);
}
