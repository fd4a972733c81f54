//! Files of other programs and other computers: encodings, packages, folders of meshes, meshes that are none, limits in
//! degrees, and what is said of parts that are not simulated.

use sandgait_robots::posture::Posture;
use sandgait_robots::{Import, Reading, load, load_from};
use std::fs::{create_dir_all, write};
use std::path::Path;

const SOLID: &str =
    r#"<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"#;
const FACETS: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

fn with_mesh(name: &str) -> String {
    format!(
        "<robot name=\"r\">\n<link name=\"base\">{SOLID}\n<collision><geometry><mesh filename=\"{name}\"/></geometry></collision></link></robot>"
    )
}

/// Reads `text` as `name` in a folder.
fn read_at(root: &Path, name: &str, text: impl AsRef<[u8]>) -> Result<Import, String> {
    let path = root.join(name);
    create_dir_all(path.parent().unwrap()).unwrap();
    write(&path, text).unwrap();
    load(&path).map_err(|e| e.to_string())
}

fn shapes(import: &Import) -> usize {
    import.tree.bodies[0].shapes.len()
}

/// Blank lines before the declaration, byte order marks, and the encodings of editors on Windows; names are read right.
#[test]
fn texts_of_other_programs_are_read() {
    let root = tempfile::tempdir().unwrap();
    let robot =
        |declaration: &str| format!("{declaration}<robot name=\"Läufer\"><link name=\"base\">{SOLID}</link></robot>");
    let latin = |text: &str| text.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect::<Vec<u8>>();
    let wide = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    let declared = |encoding: &str| robot(&format!("<?xml version=\"1.0\" encoding=\"{encoding}\"?>\n"));
    let cases: Vec<(&str, Vec<u8>, bool)> = vec![
        ("a blank line", robot("\n \n<?xml version=\"1.0\"?>\n").into_bytes(), false),
        ("Latin-1, declared", latin(&declared("ISO-8859-1")), false),
        ("Windows-1252, declared", latin(&declared("windows-1252")), false),
        ("Latin-1, not declared", latin(&robot("")), true),
        ("Latin-1, declared as UTF-8", latin(&declared("UTF-8")), true),
        ("a byte order mark", [b"\xef\xbb\xbf".to_vec(), declared("utf-8").into_bytes()].concat(), false),
        ("UTF-16 with a mark", [b"\xff\xfe".to_vec(), wide(&declared("UTF-16"))].concat(), false),
        ("UTF-16 without", wide(&declared("UTF-16")), false),
        ("UTF-8 that declares UTF-16", declared("utf-16").into_bytes(), false),
    ];
    for (what, bytes, said) in cases {
        let import = read_at(root.path(), "r.urdf", &bytes).unwrap_or_else(|e| panic!("{what}: {e}"));
        assert_eq!(import.tree.name, "Läufer", "{what}");
        assert_eq!(import.warnings.iter().any(|w| w.contains("Latin-1")), said, "{what}: {:?}", import.warnings);
    }
    let wrong = read_at(root.path(), "r.urdf", "\n\n<?xml version=\"1.0\"?>\n<robot>\n<link/></robot>").err().unwrap();
    assert!(wrong.contains("line 5"), "{wrong}");
    let cut = read_at(
        root.path(),
        "r.urdf",
        [&b"<?xml version=\"1.0\" encoding=\"EUC-KR\"?>"[..], b"<!-- \xff -->"].concat(),
    );
    assert!(cut.err().unwrap().contains("EUC-KR"));
}

/// A mesh in the web, and meshes that are none, are refused with the cause and what to do.
#[test]
fn refused_meshes_say_what_to_do() {
    let root = tempfile::tempdir().unwrap();
    for (name, content, words) in [
        ("https://example.org/foot.stl", "", &["https://", "download the file into the robot's package"][..]),
        ("a.obj", "v 0 0\nf 1 2 3\n", &["no OBJ", "again"]),
        ("b.obj", "v 0 0 0\nf 1 2 3\n", &["OBJ", "again"]),
        ("c.dae", "<COLLADA>", &["no COLLADA", "again"]),
        ("d.stl", "solid a\nfacet normal 0 0 1\nouter loup\nendsolid a\n", &["no STL", "again"]),
        ("e.obj", "# nothing\n", &["no triangles", "again"]),
    ] {
        if !name.contains(':') {
            write(root.path().join(name), content).unwrap();
        }
        let said = read_at(root.path(), "r.urdf", with_mesh(name)).err().unwrap();
        assert!(words.iter().all(|word| said.contains(word)) && !said.contains('\n'), "{name}: {said}");
    }
}

/// MuJoCo and ROS read texts that are not quite XML; so do we, and say so. What they do not read is refused with its line.
#[test]
fn texts_that_are_not_quite_xml_are_read() {
    let root = tempfile::tempdir().unwrap();
    let link = |inner: &str| format!("<robot name=\"r\">\n<link name=\"base\">{SOLID}{inner}</link></robot>");
    for (inner, line) in [
        (r#"<visual name="a"group="1"><geometry><sphere radius="1"/></geometry></visual>"#, 2),
        ("<!-- a -- b -->", 2),
        ("\n<visual name=\"a & b\"><geometry><sphere radius=\"1\"/></geometry></visual>", 3),
        ("<visual>&nbsp;<geometry><sphere radius=\"1\"/></geometry></visual>", 2),
    ] {
        let import = read_at(root.path(), "r.urdf", link(inner)).unwrap_or_else(|e| panic!("{inner}: {e}"));
        let said = &import.warnings[0];
        assert!(said.starts_with(&format!("line {line} is no XML (")) && said.contains("MuJoCo"), "{inner}: {said}");
    }
    let cut = link("");
    for (text, words) in [
        (&cut[..cut.len() - 8], "line 2: no XML"),
        (&link("<a></b>")[..], "line 2: no XML: expected 'a' tag, not 'b'"),
        ("\n<!DOCTYPE robot [\n<!ENTITY m \"6\">]><robot/>", "line 3: a document type with entities"),
    ] {
        let said = read_at(root.path(), "r.urdf", text).err().unwrap();
        assert!(said.contains(words) && said.contains("xmllint") && !said.contains('\n'), "{said}");
    }
}

/// Meshes beside the folder of the description, whatever that folder is called; not beyond two levels without a checkout,
/// and never outside of a checkout.
#[test]
fn meshes_lie_beside_the_folder_of_the_description() {
    let root = tempfile::tempdir().unwrap();
    create_dir_all(root.path().join("meshes")).unwrap();
    write(root.path().join("meshes/trunk.obj"), FACETS).unwrap();
    for (folder, up) in [("urdfs", ".."), ("description", ".."), ("xacro", ".."), ("urdf/v2", "../..")] {
        let import = read_at(root.path(), &format!("{folder}/r.urdf"), with_mesh(&format!("{up}/meshes/trunk.obj")));
        assert_eq!(shapes(&import.unwrap()), 1, "{folder}");
    }
    let deep = with_mesh("../../../meshes/trunk.obj");
    let said = read_at(root.path(), "a/b/c/r.urdf", &deep).err().unwrap();
    assert!(said.contains("outside") && said.contains("--packages") && said.contains("package.xml"), "{said}");
    create_dir_all(root.path().join(".git")).unwrap();
    assert_eq!(shapes(&read_at(root.path(), "a/b/c/r.urdf", &deep).unwrap()), 1);
    // The checkout inside ends at its own root.
    create_dir_all(root.path().join("a/.git")).unwrap();
    assert!(read_at(root.path(), "a/b/c/r.urdf", &deep).err().unwrap().contains("outside"));
    // So does a link that leads out.
    #[cfg(unix)]
    std::os::unix::fs::symlink(root.path().join("meshes/trunk.obj"), root.path().join("a/out.obj")).unwrap();
    #[cfg(unix)]
    assert!(read_at(root.path(), "a/b/r.urdf", with_mesh("../out.obj")).err().unwrap().contains("outside"));
}

/// Another package of the workspace is read if the user allows its folder; the refusal says how.
#[test]
fn packages_are_read_where_the_user_allows_them() {
    let root = tempfile::tempdir().unwrap();
    for package in ["my_bot", "other_pkg"] {
        let folder = root.path().join("src").join(package);
        create_dir_all(folder.join("meshes")).unwrap();
        write(folder.join("package.xml"), format!("<package><name>{package}</name></package>")).unwrap();
    }
    write(root.path().join("src/other_pkg/meshes/lidar.obj"), FACETS).unwrap();
    write(root.path().join("src/my_bot/meshes/trunk.obj"), FACETS).unwrap();
    let sibling = with_mesh("package://other_pkg/meshes/lidar.obj");
    let said = read_at(root.path(), "src/my_bot/urdf/r.urdf", &sibling).err().unwrap();
    assert!(
        said.contains("--packages") && said.contains("SANDGAIT_PACKAGES") && said.contains("src has one"),
        "{said}"
    );
    let path = root.path().join("src/my_bot/urdf/r.urdf");
    for allowed in ["src", "src/other_pkg", "."] {
        let packages = Reading { packages: vec![root.path().join(allowed)], ..Reading::default() };
        let import = load_from(&path, &Posture::default(), &packages).unwrap();
        assert_eq!(shapes(&import), 1, "{allowed}");
    }
    let absent = Reading { packages: vec![root.path().join("absent")], ..Reading::default() };
    let none = load_from(&path, &Posture::default(), &absent).err().unwrap();
    assert!(none.to_string().contains("packages") && none.to_string().contains("no folder"), "{none}");
    // Inside of the allowed package, a path still cannot climb out of it.
    let climbs = read_at(root.path(), "src/my_bot/urdf/r.urdf", with_mesh("package://my_bot/../../../etc/hostname"));
    assert!(climbs.err().unwrap().contains("outside"));
}

/// Paths of the author's computer, and those that Windows writes.
#[test]
fn paths_of_another_computer_are_found_by_their_names() {
    let root = tempfile::tempdir().unwrap();
    let bot = root.path().join("bot");
    for folder in ["meshes/left", "meshes/right"] {
        create_dir_all(bot.join(folder)).unwrap();
        write(bot.join(folder).join("leg.obj"), FACETS).unwrap();
    }
    write(bot.join("package.xml"), "<package><name>bot</name></package>").unwrap();
    write(bot.join("meshes/trunk.obj"), FACETS).unwrap();
    let read = |name: &str| read_at(&bot, "urdf/r.urdf", with_mesh(name));
    assert_eq!(shapes(&read(r"..\meshes\trunk.obj").unwrap()), 1);
    for away in
        [r"C:\Users\me\bot\meshes\trunk.obj", "/home/me/ws/trunk.obj", "file:///home/me/Trunk.obj", r"D:\right\leg.obj"]
    {
        let import = read(away).unwrap_or_else(|e| panic!("{away}: {e}"));
        assert!(import.warnings.iter().any(|w| w.contains("another computer")), "{away}: {:?}", import.warnings);
    }
    // A folder that is allowed, and in which the package lies, has no second file.
    let whole = Reading { packages: vec![root.path().to_owned(), bot.clone()], ..Reading::default() };
    write(bot.join("urdf/r.urdf"), with_mesh("/home/me/ws/trunk.obj")).unwrap();
    assert_eq!(shapes(&load_from(&bot.join("urdf/r.urdf"), &Posture::default(), &whole).unwrap()), 1);
    // A package without a name is the folder of the description, as onshape-to-robot writes it.
    write(bot.join("urdf/body.obj"), FACETS).unwrap();
    for here in ["package:///body.obj", "package://body.obj"] {
        assert_eq!(shapes(&read(here).unwrap_or_else(|e| panic!("{here}: {e}"))), 1);
    }
    let climbs = read("package:///../../../etc/hostname").err().unwrap();
    assert!(climbs.contains("no folder called"), "{climbs}");
    let two = read("/home/me/leg.obj").err().unwrap();
    assert!(two.contains("left/leg.obj") && two.contains("right/leg.obj"), "{two}");
    let none = read("/home/me/tail.obj").err().unwrap();
    assert!(none.contains("absolute") && none.contains("outside"), "{none}");
    let beside = read("../mesh/trunk.obj").err().unwrap();
    assert!(beside.contains("the package has meshes/trunk.obj") && beside.contains("line 3"), "{beside}");
}

/// A binary STL of one tetrahedron.
fn binary_stl() -> Vec<u8> {
    let points = [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut bytes = [vec![0; 80], 4u32.to_le_bytes().to_vec()].concat();
    for face in [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] {
        bytes.extend([0; 12]);
        bytes.extend(face.iter().flat_map(|k| points[*k]).flat_map(f32::to_le_bytes));
        bytes.extend([0; 2]);
    }
    bytes
}

/// Each mesh that is none gets its true reason, with line and element of the robot's file.
#[test]
fn broken_meshes_get_their_reasons() {
    let root = tempfile::tempdir().unwrap();
    let whole = binary_stl();
    let facet = "  FACET NORMAL 0 0 1\n    OUTER LOOP\n      VERTEX 0 0 0\n      VERTEX 1.0E0 0 0\n      VERTEX 0 1 0\n    ENDLOOP\n  ENDFACET\n";
    let cases: Vec<(&str, Vec<u8>, &str)> = vec![
        ("lfs.stl", b"version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 684\n".to_vec(), "git lfs pull"),
        ("lfs.obj", b"version https://git-lfs.github.com/spec/v1\n".to_vec(), "git lfs pull"),
        ("lfs.dae", b"version https://git-lfs.github.com/spec/v1\n".to_vec(), "git lfs pull"),
        ("page.stl", b"\n<!DOCTYPE html>\n<html></html>".to_vec(), "web page"),
        ("page.dae", b"<html lang=\"en\"></html>".to_vec(), "web page"),
        ("absent.stl", b"404: Not Found".to_vec(), "404: not found"),
        ("zero.stl", Vec::new(), "is empty"),
        ("zero.dae", Vec::new(), "is empty"),
        ("cut.stl", whole[..200].to_vec(), "200 bytes of 284"),
        ("head.stl", whole[..60].to_vec(), "60 bytes"),
        ("long.stl", [&whole[..], &[0; 7]].concat(), "291 bytes"),
        ("text.stl", format!("solid a\n{}", facet.to_lowercase().repeat(3)).into_bytes(), "endsolid"),
    ];
    for (name, bytes, word) in cases {
        write(root.path().join(name), bytes).unwrap();
        let said = read_at(root.path(), "r.urdf", with_mesh(name)).err().unwrap();
        assert!(said.contains(word) && said.contains(name), "{name}: {said}");
        assert!(said.contains("r.urdf") && said.contains("line 3"), "{name}: {said}");
        assert!(said.lines().count() == 1, "{said}");
    }
    write(root.path().join("whole.stl"), &whole).unwrap();
    assert_eq!(shapes(&read_at(root.path(), "r.urdf", with_mesh("whole.stl")).unwrap()), 1);
    let corner = |face: [usize; 3]| {
        let points = ["0 0 0", "1.0E0 0 0", "0 1 0", "0 0 1"];
        let [a, b, c] = face.map(|k| points[k]);
        format!("FACET NORMAL 0 0 0\nOUTER LOOP\nVERTEX {a}\nVERTEX {b}\nVERTEX {c}\nENDLOOP\nENDFACET\n")
    };
    let faces: String = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].map(corner).concat();
    write(root.path().join("capitals.STL"), format!("SOLID A\n{faces}ENDSOLID A\n")).unwrap();
    assert_eq!(shapes(&read_at(root.path(), "r.urdf", with_mesh("capitals.STL")).unwrap()), 1);
}

fn leg(limits: &str) -> String {
    format!(
        "<robot name=\"r\"><link name=\"base\">{SOLID}</link><link name=\"leg\">{SOLID}</link>\n<joint name=\"hip\" type=\"revolute\">\
         <parent link=\"base\"/><child link=\"leg\"/><axis xyz=\"0 1 0\"/>\n<limit {limits} effort=\"1\" velocity=\"1\"/></joint></robot>"
    )
}

#[test]
fn limits_in_degrees_are_refused_with_their_line() {
    let root = tempfile::tempdir().unwrap();
    for limits in [r#"lower="-149" upper="-22.9""#, r#"lower="-90" upper="90""#, r#"lower="0" upper="360""#] {
        let said = read_at(root.path(), "r.urdf", leg(limits)).err().unwrap();
        assert!(said.contains("degrees") && said.contains("line 3") && said.contains("hip"), "{limits}: {said}");
    }
    let mjcf = r#"<mujoco><compiler angle="radian"/><worldbody><body><freejoint/><geom size="0.1"/><body>
        <joint name="knee" axis="0 1 0" range="-149 -23"/><geom size="0.02" pos="0 0 -0.2"/></body></body></worldbody></mujoco>"#;
    let said = read_at(root.path(), "r.xml", mjcf).err().unwrap();
    assert!(said.contains("degrees") && said.contains("knee") && said.contains("line 2"), "{said}");
    // Several turns, and numbers that stand for "no limit", are no degrees.
    for limits in [r#"lower="-12" upper="12""#, r#"lower="-1e9" upper="1e9""#, r#"lower="-1000" upper="1000""#] {
        read_at(root.path(), "r.urdf", leg(limits)).unwrap();
    }
}

/// What has an effect elsewhere and is not simulated is a warning of its own that names the effect; what has none is not.
#[test]
fn effects_that_are_not_simulated_are_named() {
    let root = tempfile::tempdir().unwrap();
    let world = r#"<worldbody><light pos="0 0 1"/><body><freejoint/><geom size="0.1" solref="0.01 1"/><site name="s"/></body></worldbody>"#;
    let read =
        |sections: &str| read_at(root.path(), "r.xml", format!("<mujoco>{sections}{world}</mujoco>")).unwrap().warnings;
    let harmless = read(r#"<option timestep="0.001" wind="0 0 0" gravity="0 0 -9.81"/><visual/><sensor/>"#);
    assert!(harmless.iter().all(|w| !w.contains("not simulated")), "{harmless:?}");
    let line = harmless.iter().find(|w| w.contains("without effect")).unwrap();
    assert!(["<site>", "solref", "timestep", "<light>"].iter().all(|word| line.contains(word)), "{line}");
    let harmful = read(
        r#"<option wind="2 0 0" density="1.2"><flag limit="disable"/></option>
        <tendon><fixed stiffness="10"><joint joint="a" coef="1"/></fixed></tendon>"#,
    );
    assert!(harmful[0].contains("not simulated"), "{harmful:?}");
    for words in ["wind", "moving air", "density", "drag", "limit", "do not stop", "tendon", "springs"] {
        assert!(harmful[0].contains(words), "{words}: {}", harmful[0]);
    }
}
