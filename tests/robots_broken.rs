//! Broken or hostile robot files: each gives one line and exit code 2 in bounded time, and nothing is written.

use rand::{Rng as _, SeedableRng as _};
use sandgait::robots;
use std::path::Path;
use std::process::Command;

fn text(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

/// A broken file, and words that the error must contain. `urdf` and `mjcf` are files of our quadruped.
struct Broken {
    what: &'static str,
    file: &'static str,
    text: String,
    says: &'static [&'static str],
}

fn link(name: &str, inertial: &str, rest: &str) -> String {
    format!("<link name=\"{name}\">{inertial}{rest}</link>")
}

const SOLID: &str =
    r#"<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"#;

fn joint(name: &str, parent: &str, child: &str) -> String {
    format!(
        r#"<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"#
    )
}

fn robot(inner: &str) -> String {
    format!("<robot name=\"r\">{inner}</robot>")
}

fn with_mesh(name: &str) -> String {
    let shape = format!("<collision><geometry><mesh filename=\"{name}\"/></geometry></collision>");
    robot(&link("base", SOLID, &shape))
}

fn broken_urdf() -> Vec<Broken> {
    let urdf = text("robots/sandcat.urdf");
    let entry = |what, text, says| Broken { what, file: "robot.urdf", text, says };
    let changed = |from: &str, to: &str| {
        assert!(urdf.contains(from), "{from}");
        urdf.replacen(from, to, 1)
    };
    let inertia = |values: &str| {
        robot(&link("base", &format!("<inertial><mass value=\"1\"/><inertia {values}/></inertial>"), ""))
    };
    let (a, b, c) = (link("a", SOLID, ""), link("b", SOLID, ""), link("c", SOLID, ""));
    let bomb: String = (1..12).map(|k| format!("<!ENTITY e{k} \"{}\">", format!("&e{};", k - 1).repeat(20))).collect();
    vec![
        entry("a ring", robot(&format!("{a}{b}{}{}", joint("j", "a", "b"), joint("k", "b", "a"))), &["circle"]),
        entry(
            "a ring beside a root",
            robot(&format!("{a}{b}{c}{}{}", joint("j", "b", "c"), joint("k", "c", "b"))),
            &["circle"],
        ),
        entry(
            "a closed chain",
            robot(&format!("{a}{b}{c}{}{}{}", joint("j", "a", "b"), joint("k", "a", "c"), joint("l", "b", "c"))),
            &["closed chain", "l"],
        ),
        entry("two roots", robot(&format!("{a}{b}")), &["the file has two robots"]),
        entry("a link twice", robot(&format!("{a}{a}")), &["second link"]),
        entry(
            "a joint twice",
            robot(&format!("{a}{b}{c}{}{}", joint("j", "a", "b"), joint("j", "a", "c"))),
            &["second joint"],
        ),
        entry("no such link", robot(&format!("{a}{}", joint("j", "a", "zz"))), &["zz"]),
        entry("zero mass", changed("<mass value=\"0.15\"/>", "<mass value=\"0\"/>"), &["FL_calf", "mass 0"]),
        entry("negative mass", changed("<mass value=\"0.15\"/>", "<mass value=\"-1\"/>"), &["-1", "FL_calf"]),
        entry("a base without mass", robot(&link("base", "", "")), &["base", "mass"]),
        entry(
            "a foot without mass",
            robot(&format!("{a}<link name=\"b\"/>{}", joint("j", "a", "b"))),
            &["b", "without mass"],
        ),
        entry("NaN", inertia(r#"ixx="nan" iyy="1" izz="1" ixy="0" ixz="0" iyz="0""#), &["ixx", "finite"]),
        entry("infinity", inertia(r#"ixx="1e999" iyy="1" izz="1" ixy="0" ixz="0" iyz="0""#), &["ixx", "finite"]),
        entry(
            "negative inertia",
            inertia(r#"ixx="-1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0""#),
            &["positive definite"],
        ),
        entry(
            "indefinite inertia",
            inertia(r#"ixx="1" iyy="1" izz="1" ixy="2" ixz="0" iyz="0""#),
            &["positive definite"],
        ),
        entry("no inertia", inertia(r#"ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0""#), &["positive definite"]),
        entry("half an inertia", inertia(r#"ixx="1" iyy="1""#), &["missing"]),
        entry("no number", changed("xyz=\"0 0 -0.18\"", "xyz=\"0 zero -0.18\""), &["zero", "line"]),
        entry("two numbers", changed("xyz=\"0 0 -0.18\"", "xyz=\"0 -0.18\""), &["2 numbers", "3"]),
        entry("an axis of no length", changed("axis xyz=\"1 0 0\"", "axis xyz=\"0 0 0\""), &["axis", "FL_abduction"]),
        entry("limits upside down", changed("lower=\"-2.6\"", "lower=\"2.6\""), &["lower", "FL_knee"]),
        entry("a ball joint", changed("type=\"revolute\"", "type=\"floating\""), &["floating", "FL_abduction"]),
        entry("a mimic", changed("<dynamics", "<mimic joint=\"x\"/><dynamics"), &["mimic", "FL_abduction"]),
        entry("a box of no size", urdf.replace("0.36 0.16 0.08", "0.36 0 0.08"), &["size"]),
        entry("an unknown shape", urdf.replace("<box size=\"0.36 0.16 0.08\"/>", "<cone/>"), &["cone"]),
        entry(
            "no mass at all",
            robot(&format!("{}{}{}", link("a", "", ""), link("b", "", ""), joint("j", "a", "b"))),
            &["no body has a mass", "<inertial>"],
        ),
        entry("no mesh", with_mesh("absent.stl"), &["absent.stl", "line 1"]),
        entry("no such package", with_mesh("package://nowhere/foot.stl"), &["nowhere"]),
        entry("climbing", with_mesh("../../../../../../etc/passwd"), &["outside"]),
        entry("climbing in a package", with_mesh("package://box/../../etc/hostname"), &["outside"]),
        entry("an absolute path", with_mesh("/etc/hostname"), &["absolute"]),
        entry("a link out", with_mesh("out.stl"), &["outside"]),
        entry("a folder", with_mesh("folder.stl"), &["no file"]),
        entry("a mesh of noise", with_mesh("noise.stl"), &["noise.stl"]),
        entry("a cut mesh", with_mesh("cut.stl"), &["cut.stl"]),
        entry("a flat mesh", with_mesh("flat.obj"), &["flat"]),
        entry("a mesh of nothing", with_mesh("empty.obj"), &["empty.obj", "triangles"]),
        entry("a million triangles", with_mesh("million.stl"), &["million.stl", "triangles"]),
        entry("a mesh of another kind", with_mesh("mesh.fbx"), &[".stl, .obj and .dae"]),
        entry("a scene in circles", with_mesh("circle.dae"), &["circle.dae", "scene"]),
        entry("a bomb in a mesh", with_mesh("bomb.dae"), &["bomb.dae"]),
        entry(
            "a bomb",
            format!("<!DOCTYPE r [<!ENTITY e0 \"ha\">{bomb}]><robot name=\"r\">&e11;</robot>"),
            &["document type"],
        ),
        entry(
            "a file by an entity",
            "<!DOCTYPE r [<!ENTITY e SYSTEM \"file:///etc/passwd\">]><robot name=\"&e;\"/>".into(),
            &["document type"],
        ),
        entry("nested too deep", format!("{}{}", "<robot>".repeat(100_000), "</robot>".repeat(100_000)), &["nested"]),
        entry(
            "too many attributes",
            format!("<robot name=\"r\"{}/>", (0..90_000).map(|k| format!(" a{k}=\"\"")).collect::<String>()),
            &["line 1", "more than 250 attributes"],
        ),
        entry("too many elements", robot(&"<gazebo/>".repeat(300_000)), &["nodes"]),
        entry("too large", format!("<robot name=\"{}\"/>", "x".repeat(9 << 20)), &["MiB"]),
        entry("cut off", urdf[..urdf.len() / 2].into(), &["no XML"]),
        entry("nothing", String::new(), &["is empty"]),
        entry("a web page", "<html/>".into(), &["web page"]),
        entry("another root", "<sdf/>".into(), &["neither"]),
        entry("no links", robot(""), &["no <link>"]),
        entry("too far", changed("xyz=\"0 0 -0.18\"", "xyz=\"0 0 -1e9\""), &["100 m"]),
    ]
}

fn broken_mjcf() -> Vec<Broken> {
    let mjcf = text("robots/sandcat.xml");
    let entry = |what, text, says| Broken { what, file: "robot.xml", text, says };
    let changed = |from: &str, to: &str| {
        assert!(mjcf.contains(from), "{from}");
        mjcf.replacen(from, to, 1)
    };
    let world = |inner: &str| format!("<mujoco><worldbody>{inner}</worldbody></mujoco>");
    vec![
        entry(
            "a ball joint",
            changed("<joint name=\"FL_abduction\" class=\"abduction\"/>", "<joint type=\"ball\"/>"),
            &["ball"],
        ),
        entry(
            "equality",
            changed("<keyframe>", "<equality><connect body1=\"trunk\"/></equality><keyframe>"),
            &["connect"],
        ),
        entry("composite", changed("<freejoint/>", "<freejoint/><composite/>"), &["composite"]),
        entry(
            "no class",
            changed("class=\"abduction\"/>\n        <geom", "class=\"none\"/>\n        <geom"),
            &["none", "class"],
        ),
        entry("no joint", changed("joint=\"FL_knee\"", "joint=\"FL_kne\""), &["FL_kne"]),
        entry("including itself", changed("<default>", "<include file=\"robot.xml\"/><default>"), &["circular"]),
        entry(
            "including what is outside",
            changed("<default>", "<include file=\"../../etc/passwd\"/><default>"),
            &["outside"],
        ),
        entry("including nothing", changed("<default>", "<include file=\"absent.xml\"/><default>"), &["absent.xml"]),
        entry("no free body", world("<body><geom size=\"1\"/></body><body><geom size=\"1\"/></body>"), &["free joint"]),
        entry(
            "the file has two robots",
            world(
                "<body name=\"a\"><freejoint/><geom size=\"1\"/></body><body name=\"b\"><freejoint/><geom size=\"1\"/></body>",
            ),
            &["the file has two robots"],
        ),
        entry("no world", "<mujoco/>".into(), &["free joint"]),
        entry(
            "no mass",
            changed("mass=\"0.15\"", "mass=\"0\"").replace("size=\"0.022\" mass=\"0.05\"", "size=\"0.022\" mass=\"0\""),
            &["FL_calf", "without mass"],
        ),
        entry("NaN mass", changed("mass=\"0.15\"", "mass=\"nan\""), &["mass", "finite"]),
        entry("a size too few", changed("size=\"0.035 0.025\"", "size=\"0.035\""), &["size"]),
        entry("a negative size", changed("size=\"0.022\"", "size=\"-0.022\""), &["size"]),
        entry("a turn about nothing", changed("quat=\"1 1 0 0\"", "quat=\"0 0 0 0\""), &["quat"]),
        entry(
            "a plane on a robot",
            changed("type=\"box\" size=\"0.18 0.08 0.04\"", "type=\"plane\" size=\"1 1 1\""),
            &["plane"],
        ),
        entry("a range upside down", changed("range=\"-0.8 0.8\"", "range=\"0.8 -0.8\""), &["range"]),
        entry(
            "two joints along one line",
            changed(
                "<joint name=\"FL_knee\" class=\"knee\"/>",
                "<joint name=\"FL_knee\" class=\"knee\"/><joint name=\"again\" class=\"knee\"/>",
            ),
            &["no inertia"],
        ),
        entry(
            "no mesh",
            changed("<freejoint/>", "<freejoint/><geom type=\"mesh\" mesh=\"absent\"/>").replacen(
                "<worldbody>",
                "<asset><mesh file=\"absent.obj\"/></asset><worldbody>",
                1,
            ),
            &["absent.obj"],
        ),
        entry("an angle of another kind", changed("angle=\"radian\"", "angle=\"gon\""), &["gon"]),
        entry(
            "a deep tree",
            world(&format!(
                "<body><freejoint/><geom size=\"1\"/>{}{}</body>",
                "<body>".repeat(50_000),
                "</body>".repeat(50_000)
            )),
            &["nested"],
        ),
    ]
}

/// Writes the meshes that the files above name.
fn meshes(folder: &Path) {
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).unwrap();
    let mut chance = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(1);
    let noise: Vec<u8> = (0..5000).map(|_| chance.random()).collect();
    write("noise.stl", &noise);
    let mut stl = vec![0u8; 80];
    stl.extend(1_000_000u32.to_le_bytes());
    write("cut.stl", &[&stl[..], &[0; 120]].concat());
    let mut facet = [0u8; 50];
    for (k, x) in [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().enumerate() {
        facet[12 + 4 * k..16 + 4 * k].copy_from_slice(&x.to_le_bytes());
    }
    write("million.stl", &[stl, facet.repeat(1_000_000)].concat());
    write("flat.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n");
    write("empty.obj", b"v 0 0 0\n");
    write("mesh.fbx", b"x");
    let nodes = r##"<node id="a"><instance_node url="#b"/><instance_node url="#b"/></node><node id="b"><instance_node url="#a"/><instance_node url="#a"/></node>"##;
    let scene = format!(
        r##"<COLLADA><library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>
        <scene><instance_visual_scene url="#s"/></scene></COLLADA>"##
    );
    write("circle.dae", scene.as_bytes());
    write("bomb.dae", b"<!DOCTYPE x [<!ENTITY a \"b\">]><COLLADA>&a;</COLLADA>");
    std::fs::create_dir(folder.join("folder.stl")).unwrap();
    #[cfg(unix)]
    std::os::unix::fs::symlink("/etc/hostname", folder.join("out.stl")).unwrap();
}

#[test]
fn broken_files_are_refused_in_one_line() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("box");
    std::fs::create_dir(&folder).unwrap();
    meshes(&folder);
    let count = || std::fs::read_dir(&folder).unwrap().count();
    for case in broken_urdf().into_iter().chain(broken_mjcf()) {
        let file = folder.join(case.file);
        std::fs::write(&file, &case.text).unwrap();
        let before = count();
        let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
        let output =
            command.current_dir(&folder).arg("robot").arg(&file).args(["--picture", "robot.png"]).output().unwrap();
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{}: {line}", case.what);
        assert!(output.stdout.is_empty() && line.lines().count() == 1 && line.len() < 700, "{}: {line}", case.what);
        assert_eq!(count(), before, "{} wrote something", case.what);
        for word in case.says {
            assert!(line.contains(word), "{}: {line:?} lacks {word:?}", case.what);
        }
    }
}

#[test]
fn wrong_uses_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("robot.urdf");
    let robot = text("robots/sandcat.urdf");
    std::fs::write(&file, robot).unwrap();
    let states = folder.path().join("states.json");
    let file = file.to_str().unwrap();
    let row = |n: usize| {
        format!(r#"{{"quat":[1,0,0,0],"v":[0,0,0],"w":[0,0,0],"q":{0:?},"qd":{0:?},"tau":{0:?}}}"#, vec![0.0; n])
    };
    let at = states.to_str().unwrap();
    let cases: Vec<(Vec<&str>, String, &str)> = vec![
        (vec![file, "--touches", "FL_fot"], String::new(), "FL_foot"),
        (vec![file, "--plate-size", "0"], String::new(), "plate-size"),
        (vec![file, "--plate-size", "0.0001"], String::new(), "plates"),
        (vec!["robot.png"], String::new(), ".urdf"),
        (vec!["absent.urdf"], String::new(), "absent.urdf"),
        (vec!["no-such-robot"], String::new(), "no-such-robot"),
        (vec![file, "--accelerations", at], "[".into(), "JSON"),
        (vec![file, "--accelerations", at], "{}".into(), "rows"),
        (vec![file, "--accelerations", at], format!("[{}]", row(3)), "12 joints"),
        (vec![file, "--accelerations", at], format!("{{\"joints\":[\"x\"],\"rows\":[{}]}}", row(1)), "\"x\""),
        (vec![file, "--accelerations", at], format!("{{\"joints\":[\"FL_knee\"],\"rows\":[{}]}}", row(1)), "missing"),
        (vec![file, "--accelerations", at], format!("[{}]", row(12).replace("[1,0,0,0]", "[0,0,0,0]")), "quat"),
        (vec![file, "--accelerations", at], format!("[{}]", row(12).replace("[0,0,0]", "[1e200,0,0]")), "finite"),
    ];
    for (arguments, text, word) in cases {
        std::fs::write(&states, text).unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_sandgait")).arg("robot").args(&arguments).output().unwrap();
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
        assert!(output.stdout.is_empty() && line.lines().count() == 1, "{arguments:?}: {line}");
        assert!(line.contains(word), "{arguments:?}: {line:?} lacks {word:?}");
    }
}

/// Files with bytes changed, cut out, doubled and swapped are read or refused, without a panic, and those that are read
/// can be simulated.
#[test]
fn mutants_are_read_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut chance = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(11);
    let (mut read, mut refused) = (0, 0);
    let words = [
        "0", "-1", "nan", "1e308", "1e-320", "\"", "<", "/>", "world", "mesh", "0 0 0", "&#0;", "free", "ball", "true",
    ];
    for name in ["robots/sandcat.urdf", "robots/sandcat.xml", "tests/data/robots/odd.xml", "tests/data/robots/odd.urdf"]
    {
        let whole = text(name).into_bytes();
        let file = folder.path().join(Path::new(name).file_name().unwrap());
        for _ in 0..150 {
            let mut bytes = whole.clone();
            for _ in 0..chance.random_range(1..3) {
                let at = chance.random_range(0..bytes.len());
                let end = (at + chance.random_range(1..30)).min(bytes.len());
                match chance.random_range(0..8) {
                    0 => bytes[at] = chance.random(),
                    1 => drop(bytes.drain(at..end)),
                    2 => drop(bytes.splice(end..end, whole[at.min(whole.len() - 1)..end.min(whole.len())].to_vec())),
                    3..7 => {
                        // Replaces the value of an attribute.
                        let quotes: Vec<usize> = (0..bytes.len()).filter(|k| bytes[*k] == b'"').collect();
                        let pair = 2 * chance.random_range(0..quotes.len() / 2);
                        let (from, to) = (quotes[pair] + 1, quotes[pair + 1]);
                        let word = words[chance.random_range(0..words.len())];
                        bytes.splice(from..to, word.bytes());
                    }
                    _ => bytes.swap(at, end - 1),
                }
            }
            std::fs::write(&file, &bytes).unwrap();
            match robots::load(&file) {
                Ok(import) => {
                    read += 1;
                    assert!(import.tree.mass() > 0.0);
                    import.touching(None).unwrap();
                }
                Err(error) => {
                    refused += 1;
                    let line = error.to_string();
                    assert!(line.lines().count() == 1 && line.len() < 900, "{line}");
                }
            }
        }
    }
    assert!(read > 50 && refused > 200, "{read} read, {refused} refused");
}
