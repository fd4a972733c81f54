//! Files as outside users have them: parts that are only drawn, armatures, floating bases, paths, and what refusals say.

use sandgait_robots::{Import, load};
use std::path::Path;

const SOLID: &str =
    r#"<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"#;

/// A base called `base` with `inside`, and a leg; `beside` stands beside them.
fn urdf(inside: &str, beside: &str) -> String {
    format!(
        r#"<robot name="r"><link name="base">{SOLID}{inside}</link><link name="leg">{SOLID}</link>
        <joint name="hip" type="revolute"><parent link="base"/><child link="leg"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>{beside}</robot>"#
    )
}

fn mjcf(world: &str, after: &str) -> String {
    format!(r#"<mujoco><worldbody>{world}</worldbody>{after}</mujoco>"#)
}

fn read_in(folder: &Path, name: &str, text: &str) -> Result<Import, String> {
    std::fs::write(folder.join(name), text).unwrap();
    load(&folder.join(name)).map_err(|e| e.to_string())
}

fn read(name: &str, text: &str) -> Result<Import, String> {
    read_in(tempfile::tempdir().unwrap().path(), name, text)
}

fn refused(name: &str, text: &str) -> String {
    let line = read(name, text).err().unwrap();
    assert_eq!(line.lines().count(), 1, "{line}");
    line
}

fn mesh(tag: &str, file: &str) -> String {
    format!(r#"<{tag}><geometry><mesh filename="{file}"/></geometry></{tag}>"#)
}

/// As in MJCF: motion needs no visuals, so their errors are one warning with their number.
#[test]
fn visuals_that_cannot_be_read_are_left_out() {
    let broken = [
        mesh("visual", "absent.stl"),
        mesh("visual", "/elsewhere/absent.stl"),
        mesh("visual", "package://elsewhere/absent.stl"),
        r#"<visual><geometry><box size="0 0 0"/></geometry></visual>"#.to_owned(),
        r#"<visual><origin xyz="0 0"/><geometry><box size="1 1 1"/></geometry></visual>"#.to_owned(),
        "<visual/>".to_owned(),
    ];
    for visual in &broken {
        let import = read("r.urdf", &urdf(visual, "")).unwrap();
        assert!(import.warnings.iter().any(|w| w.starts_with("1 visual is not drawn")), "{:?}", import.warnings);
        let collision = visual.replace("visual", "collision");
        refused("r.urdf", &urdf(&collision, ""));
        // The link is drawn by its collision shape instead.
        let solid = r#"<collision><geometry><box size="1 1 1"/></geometry></collision>"#;
        let import = read("r.urdf", &urdf(&(visual.clone() + solid), "")).unwrap();
        assert_eq!(import.seen().unwrap()[0].len(), 1);
    }
    let good = r#"<visual><geometry><box size="1 1 1"/></geometry></visual>"#;
    let import = read("r.urdf", &urdf(&(broken.concat() + good), "")).unwrap();
    assert_eq!(import.warnings.iter().filter(|w| w.contains("drawn")).count(), 1, "{:?}", import.warnings);
    let said = &import.warnings[0];
    assert!(said.starts_with("6 visuals are not drawn") && said.contains("absent.stl"), "{said}");
    assert_eq!(import.seen().unwrap()[0].len(), 1);
}

/// Play of a gear as a second joint along the same line: MuJoCo simulates it, because rotors have inertia.
#[test]
fn joints_along_one_line_need_an_armature() {
    let leg = |armature: &str| {
        mjcf(
            &format!(
                r#"<body name="base"><freejoint/><geom size="0.1"/><body name="leg"><joint name="knee" axis="0 1 0" {armature}/>
                <joint name="play" axis="0 1 0" range="-1 1" {armature}/><geom size="0.02" pos="0 0 -0.2"/></body></body>"#
            ),
            "",
        )
    };
    let import = read("r.xml", &leg(r#"armature="0.01""#)).unwrap();
    assert_eq!(import.tree.joints().count(), 2);
    let said = refused("r.xml", &leg(""));
    assert!(said.contains("no inertia to move") && said.contains("armature"), "{said}");
}

/// A floating joint below a root without mass is a free base; elsewhere it is refused.
#[test]
fn a_floating_joint_below_the_root_frees_the_base() {
    let floats = |parent: &str, child: &str| {
        format!(r#"<joint name="to_{child}" type="floating"><parent link="{parent}"/><child link="{child}"/></joint>"#)
    };
    let world = |inside: &str| format!(r#"<link name="world">{inside}</link>"#);
    let import = read("r.urdf", &urdf("", &(world("") + &floats("world", "base")))).unwrap();
    let fixed = read("r.urdf", &urdf("", "")).unwrap();
    assert_eq!(import.tree, fixed.tree);
    assert!(import.base_is_free && !fixed.base_is_free);
    let ball = format!(r#"<link name="ball">{SOLID}</link>"#);
    let wrong = [
        world(SOLID) + &floats("world", "base"),
        ball.clone() + &floats("base", "ball"),
        world("") + &ball + &floats("world", "base") + &floats("world", "ball"),
    ];
    for beside in wrong {
        let said = refused("r.urdf", &urdf("", &beside));
        assert!(said.contains("floating") && said.contains("fixed"), "{said}");
    }
}

/// Converters write absolute paths. They are read inside of the package, where no other file can be reached.
#[test]
fn absolute_paths_are_read_inside_of_the_package() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("urdf");
    std::fs::create_dir(&folder).unwrap();
    let facets = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    for place in [root.path(), &folder] {
        std::fs::write(place.join("shell.obj"), facets).unwrap();
    }
    let path = root.path().canonicalize().unwrap().join("shell.obj");
    let path = path.to_str().unwrap();
    for name in [path.to_owned(), format!("file://{path}")] {
        let import = read_in(&folder, "r.urdf", &urdf(&mesh("collision", &name), "")).unwrap();
        assert_eq!(import.tree.bodies[0].shapes.len(), 1);
    }
    let deeper = folder.join("deeper");
    std::fs::create_dir(&deeper).unwrap();
    let outside = |name: &str| read_in(&deeper, "r.urdf", &urdf(&mesh("collision", name), "")).err().unwrap();
    for name in [path.to_owned(), format!("file://{path}"), format!("file://{path}/../../../etc/hostname")] {
        let said = outside(&name);
        assert!(said.contains("outside") && said.contains("absolute"), "{said}");
    }
    let deepest = deeper.join("deepest");
    std::fs::create_dir(&deepest).unwrap();
    let climbs = urdf(&mesh("collision", "../../../shell.obj"), "");
    let said = read_in(&deepest, "r.urdf", &climbs).err().unwrap();
    assert!(said.contains("outside") && said.contains("package.xml"), "{said}");
    std::fs::write(root.path().join("package.xml"), "<package><name>p</name></package>").unwrap();
    read_in(&deepest, "r.urdf", &climbs).unwrap();
}

/// An equality that is refused is named by its kind and both ends.
#[test]
fn refused_equalities_name_their_kind_and_both_ends() {
    let body = r#"<body name="base"><freejoint/><geom size="0.1"/></body>"#;
    let said = |line: &str| refused("r.xml", &mjcf(body, &format!("<equality>{line}</equality>")));
    let ties = said(r#"<tendon tendon1="left" tendon2="right"/>"#);
    assert!(ties.contains("tendon \"left\"") && ties.contains("tendon \"right\"") && !ties.contains("chain"), "{ties}");
    let holds = said(r#"<tendon tendon1="left"/>"#);
    assert!(holds.contains("holds the length of tendon \"left\""), "{holds}");
    let welds = said(r#"<weld body1="foot"/>"#);
    assert!(welds.contains("<weld>") && welds.contains("\"foot\" and the world"), "{welds}");
    let connects = said(r#"<connect site1="a" site2="b"/>"#);
    assert!(connects.contains("closes a chain between \"a\" and \"b\""), "{connects}");
}

/// MuJoCo ignores all equalities if an option switches them off: `active` of each does not count then.
#[test]
fn an_option_switches_equalities_off() {
    let body = r#"<body name="base"><freejoint/><geom size="0.1"/></body>"#;
    let weld = r#"<equality><weld body1="base"/></equality>"#;
    for flag in ["equality", "constraint"] {
        let with = |value: &str| mjcf(body, &format!(r#"<option><flag {flag}="{value}"/></option>{weld}"#));
        assert!(refused("r.xml", &with("enable")).contains("<weld>"));
        let import = read("r.xml", &with("disable")).unwrap();
        assert!(import.warnings.iter().any(|w| w.contains("switches its equalities off")), "{:?}", import.warnings);
    }
}

/// A chain that a URDF closes for other programs is refused as one of MJCF is; so no robot walks with a leg that hangs loose.
#[test]
fn chains_that_a_urdf_closes_are_refused() {
    let gazebo = |parent: &str| {
        format!(
            r#"<gazebo><joint name="j" type="ball"><parent>{parent}</parent><child>r::base</child></joint></gazebo>"#
        )
    };
    let drake = r#"<loop_joint name="j" type="ball"><link1 link="a"/><link2 link="b"/></loop_joint>"#.to_owned();
    for (closing, ends) in [(drake, "\"a\" and \"b\""), (gazebo("leg"), "\"leg\" and \"base\"")] {
        let said = refused("r.urdf", &urdf("", &closing));
        assert!(said.contains("line ") && said.contains("closes a chain between") && said.contains(ends), "{said}");
        assert!(said.contains("delete this element"), "{said}");
    }
    read("r.urdf", &urdf("", &gazebo("world"))).unwrap();
}

/// A hint names what there is in the file: there may be no body that is the base.
#[test]
fn bodies_without_a_free_joint_are_counted() {
    let leg = r#"<body><geom size="0.1"/></body>"#;
    let said = refused("r.xml", &mjcf(&leg.repeat(2), ""));
    assert!(said.contains("2 bodies") && said.contains("wrap the bodies in a <body> with <freejoint/>"), "{said}");
    let said = refused("r.xml", &mjcf("", ""));
    assert!(said.contains("no <body>") && said.contains("free joint"), "{said}");
}
