//! Robots from files: the dynamics agree with other programs, and the plates agree with the exact shapes.

use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector3};
use sandgait::number::Vec3;
use sandgait::robots::{self, Import, states};
use sandgait::sand::intruder::{IntruderPlate, area, volume};
use sandgait::sim::tree::{Geometry, TreeShape, plates};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

#[path = "../examples/plates_study.rs"]
mod plates_study;

type V = Vector3<f64>;

fn here(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

fn load(name: &str) -> Import {
    robots::load(&here(name)).unwrap()
}

fn json(arguments: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_sandgait")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A robot's file, and accelerations that pinocchio or MuJoCo computes for it.
const REFERENCES: [(&str, &str); 5] = [
    ("tests/data/robots/solo12.urdf", "tests/data/robots/solo12.json"),
    ("tests/data/robots/odd.urdf", "tests/data/robots/odd_urdf.json"),
    ("tests/data/robots/odd.xml", "tests/data/robots/odd_mjcf.json"),
    ("robots/sandcat.urdf", "tests/data/robots/sandcat_urdf.json"),
    ("robots/sandcat.xml", "tests/data/robots/sandcat_mjcf.json"),
];

/// Frames, inertias and dynamics are tested together: a number of the file that is read wrongly changes the
/// accelerations.
#[test]
fn accelerations_are_those_of_pinocchio_and_mujoco() {
    for (file, reference) in REFERENCES {
        let robot = load(file);
        let wanted: Value = serde_json::from_str(&std::fs::read_to_string(here(reference)).unwrap()).unwrap();
        assert!((robot.tree.mass() / wanted["mass"].as_f64().unwrap() - 1.0).abs() < 1e-12, "{file}");
        let found = states::compute(&robot.tree, &here(reference)).unwrap();
        let rows = wanted["rows"].as_array().unwrap();
        assert_eq!(rows.len(), found.len());
        for (row, found) in rows.iter().zip(&found) {
            for (key, found) in [("a", &found.a[..]), ("alpha", &found.alpha[..]), ("qdd", &found.qdd[..])] {
                let wanted: Vec<f64> = serde_json::from_value(row[key].clone()).unwrap();
                let size = wanted.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
                for (x, y) in wanted.iter().zip(found) {
                    assert!((x - y).abs() <= 1e-9 * size, "{file}, {key}: {x} and {y}");
                }
            }
        }
    }
}

#[test]
fn rows_may_be_bare_and_joints_in_any_order() {
    let file = here("tests/data/robots/solo12.json");
    let robot = here("tests/data/robots/solo12.urdf");
    let robot = robot.to_str().unwrap();
    let named = json(&["robot", robot, "--accelerations", file.to_str().unwrap()]);
    let mut states: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
    let own = json(&["robot", robot, "--json"])["joints"].clone();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("states.json");
    let computed = |states: &Value| {
        std::fs::write(&path, states.to_string()).unwrap();
        json(&["robot", robot, "--accelerations", path.to_str().unwrap()])
    };
    // The joints of this file are in the robot's order.
    assert_eq!(states["joints"], own);
    assert_eq!(computed(&states["rows"]), named);
    let turned = |list: &mut Value| list.as_array_mut().unwrap().reverse();
    turned(&mut states["joints"]);
    for row in states["rows"].as_array_mut().unwrap() {
        ["q", "qd", "tau"].iter().for_each(|key| turned(&mut row[key]));
    }
    let mut back = computed(&states);
    back.as_array_mut().unwrap().iter_mut().for_each(|row| turned(&mut row["qdd"]));
    assert_eq!(back, named);
}

/// The URDF has the inertias as numbers; for the MJCF they are computed from its shapes.
#[test]
fn urdf_and_mjcf_of_a_robot_agree() {
    let [a, b] = ["robots/sandcat.urdf", "robots/sandcat.xml"].map(load);
    assert!(a.warnings.is_empty() && b.warnings.is_empty(), "{:?} {:?}", a.warnings, b.warnings);
    assert_eq!(a.tree.bodies.len(), 13);
    for (a, b) in a.tree.bodies.iter().zip(&b.tree.bodies) {
        assert_eq!((&a.name, a.parent, a.shapes.len()), (&b.name, b.parent, b.shapes.len()));
        assert!((a.mass - b.mass).abs() < 1e-12 && (a.center - b.center).norm() < 1e-12, "{}", a.name);
        assert!((a.inertia - b.inertia).norm() < 1e-11, "{}: {} {}", a.name, a.inertia, b.inertia);
        assert!((a.origin.translation.vector - b.origin.translation.vector).norm() < 1e-12);
        let (Some(a), Some(b)) = (&a.joint, &b.joint) else { continue };
        assert_eq!(
            (&a.name, a.axis, a.range, a.damping, a.friction),
            (&b.name, b.axis, b.range, b.damping, b.friction)
        );
        assert_eq!((a.torque_limit, a.speed_limit), (Some(20.0), Some(25.0)));
        assert_eq!((b.torque_limit, b.kp, b.kd), (Some(20.0), Some(40.0), Some(1.0)));
        assert!([0.0, 0.8, -1.6].contains(&b.rest.unwrap()));
    }
    let touching = |import: &Import, names: Option<&[String]>| {
        let found = import.touching(names).unwrap();
        found.iter().map(|t| import.tree.bodies[t.0].shapes[t.1].name.clone()).collect::<Vec<_>>()
    };
    let own = touching(&a, None);
    assert_eq!(own, touching(&b, None));
    assert!(own.contains(&"trunk".into()) && own.contains(&"FL_calf".into()) && own.contains(&"RR_foot".into()));
    assert!(!own.contains(&"FL_thigh".into()) && own.len() == 9, "{own:?}");
    assert_eq!(touching(&a, Some(&["FL_foot".into(), "trunk".into()])), ["trunk", "FL_foot"]);
    assert_eq!(touching(&a, Some(&["FL_calf".into()])), ["FL_calf", "FL_foot"]);
}

fn ellipsoid(half: V, bands: usize) -> Vec<[V; 3]> {
    let point = |i: usize, k: usize| {
        let (up, around) = (std::f64::consts::PI * i as f64 / bands as f64, (k % (2 * bands)) as f64);
        let (sin, cos) = (std::f64::consts::PI * around / bands as f64).sin_cos();
        let ring = if i == 0 || i == bands { 0.0 } else { up.sin() };
        V::new(ring * cos, ring * sin, -up.cos()).component_mul(&half)
    };
    let mut faces = Vec::new();
    for i in 0..bands {
        for k in 0..2 * bands {
            let [a, b, c, d] = [point(i, k), point(i, k + 1), point(i + 1, k + 1), point(i + 1, k)];
            faces.extend(
                [[a, b, c], [a, c, d]].into_iter().filter(|t| (t[1] - t[0]).cross(&(t[2] - t[0])).norm() > 0.0),
            );
        }
    }
    faces
}

fn box_faces(half: V) -> Vec<[V; 3]> {
    let mut faces = Vec::new();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let unit = |k: usize| V::ith(k % 3, half[k % 3]);
            let (n, u, v) = (unit(axis) * side, unit(axis + 1) * side, unit(axis + 2));
            let [a, b, c, d] = [n - u - v, n + u - v, n + u + v, n - u + v];
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    faces
}

fn shape(geometry: Geometry, origin: Isometry3<f64>) -> TreeShape {
    TreeShape { name: "foot".into(), origin, geometry, friction: 1.0 }
}

fn shapes() -> Vec<(&'static str, Geometry)> {
    let mesh = |faces| Geometry::Mesh(Arc::new(faces));
    vec![
        ("sphere", Geometry::Sphere { radius: 0.023 }),
        ("long capsule", Geometry::Capsule { radius: 0.012, half_length: 0.08 }),
        ("short capsule", Geometry::Capsule { radius: 0.02, half_length: 0.01 }),
        ("flat cylinder", Geometry::Cylinder { radius: 0.03, half_length: 0.01 }),
        ("long cylinder", Geometry::Cylinder { radius: 0.015, half_length: 0.06 }),
        ("box", Geometry::Box { half: V::new(0.05, 0.02, 0.01) }),
        ("mesh of a boot", mesh(ellipsoid(V::new(0.05, 0.02, 0.015), 60))),
        ("mesh of a box", mesh(box_faces(V::new(0.05, 0.02, 0.01)))),
    ]
}

/// The plates keep the shape's area and volume, whatever their size.
#[test]
fn plates_keep_area_and_volume() {
    let place =
        Isometry3::from_parts(Translation3::new(0.1, 0.2, -0.3), UnitQuaternion::from_euler_angles(0.4, 0.5, 0.6));
    for (name, geometry) in shapes() {
        for size in [None, Some(0.02), Some(0.01), Some(0.004)] {
            let shape = shape(geometry.clone(), place);
            let cut = plates::of_shapes(&[&shape], size).unwrap();
            let center = Vec3::new(0.1, 0.2, -0.3);
            let about: Vec<IntruderPlate> =
                cut.iter().map(|p| IntruderPlate { center: p.center - center, ..*p }).collect();
            let errors = [area(&cut) / geometry.area() - 1.0, volume(&about) / geometry.volume() - 1.0];
            assert!(errors.iter().all(|e| e.abs() < 0.01), "{name}, {size:?}: {errors:?}, {} plates", cut.len());
            let open = cut.iter().fold(V::zeros(), |sum, p| sum + V::from(p.normal.lane(0)) * p.area);
            assert!(open.norm() < 0.01 * geometry.area(), "{name}, {size:?}: {open}");
        }
    }
}

/// Plates inside another shape of the same body do not touch the sand.
#[test]
fn hidden_plates_are_left_out() {
    let ball = |x: f64| shape(Geometry::Sphere { radius: 0.02 }, Isometry3::translation(x, 0.0, 0.0));
    let all = |shapes: &[TreeShape]| area(&plates::of_shapes(&shapes.iter().collect::<Vec<_>>(), Some(0.002)).unwrap());
    let one = all(&[ball(0.0)]);
    // Of two overlapping spheres whose centres are a radius apart, three quarters of each surface are outside.
    assert!((all(&[ball(0.0), ball(0.02)]) / (1.5 * one) - 1.0).abs() < 0.02);
    let inner = shape(Geometry::Mesh(Arc::new(ellipsoid(V::repeat(0.01), 20))), Isometry3::identity());
    assert!((all(&[ball(0.0), inner.clone()]) / one - 1.0).abs() < 1e-12);
    let outer = shape(Geometry::Mesh(Arc::new(ellipsoid(V::repeat(0.03), 40))), Isometry3::identity());
    assert!((all(&[ball(0.0), outer.clone()]) / outer.geometry.area() - 1.0).abs() < 0.01);
}

fn write_stl(path: &Path, faces: &[[V; 3]], turn: &Rotation3<f64>) {
    let mut bytes = vec![0; 80];
    bytes.extend((faces.len() as u32).to_le_bytes());
    for face in faces {
        bytes.extend([0; 12]);
        for x in face.iter().flat_map(|p| (turn * p).iter().copied().collect::<Vec<_>>()) {
            bytes.extend((x as f32).to_le_bytes());
        }
        bytes.extend([0; 2]);
    }
    std::fs::write(path, bytes).unwrap();
}

/// Feet and lower legs of any shape, and meshes of real robots, at random poses, depths, velocities and spins: the
/// engine's force and moment with the default plates agree with the law summed over 20,000 points of the surface. The
/// seed is not the one on which the defaults were chosen.
#[test]
fn default_plates_give_the_forces_of_fine_plates() {
    let mesh = |name: &str| {
        let path = here(&format!("tests/data/feet/{name}"));
        let urdf = format!(
            r#"<robot name="r"><link name="base"><inertial><mass value="1"/>
            <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
            <collision><geometry><mesh filename="{name}"/></geometry></collision></link></robot>"#
        );
        let folder = tempfile::tempdir().unwrap();
        std::fs::copy(&path, folder.path().join(name)).unwrap();
        std::fs::write(folder.path().join("r.urdf"), urdf).unwrap();
        robots::load(&folder.path().join("r.urdf")).unwrap().tree.bodies[0].shapes[0].geometry.clone()
    };
    let files = ["bolt_lower_leg.stl", "go2_calf.stl", "go2_foot.stl", "spot_lower_leg.obj"];
    let all: Vec<(&str, Geometry)> = shapes().into_iter().chain(files.map(|name| (name, mesh(name)))).collect();
    let (mut lines, mut wrong) = (Vec::new(), false);
    for law in ["li2013", "agarwal2023"] {
        for (name, geometry) in &all {
            let shape = shape(geometry.clone(), Isometry3::identity());
            let plates = plates::of_shapes(&[&shape], None).unwrap();
            let count = plates.len();
            let e = plates_study::errors(&[&shape], plates, law, 100, 91_237).unwrap();
            lines.push(format!(
                "{law} {name}: {count} plates, {} patches; rms {:.4}, worst {:.4}, moment {:.4}",
                e.patches, e.rms, e.worst, e.moment
            ));
            wrong |= e.rms >= 0.02 || e.moment >= 0.03 || count > 128;
        }
    }
    assert!(!wrong, "{lines:#?}");
}

/// A cube as STL, OBJ and DAE, mirrored and scaled, gives the same shape with outward normals.
#[test]
fn meshes_of_all_kinds_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let faces = box_faces(V::new(0.1, 0.2, 0.3));
    write_stl(&at("cube.stl"), &faces, &Rotation3::identity());
    let points: Vec<V> = faces.iter().flatten().copied().collect();
    let list = |of: &dyn Fn(&V) -> String| points.iter().map(of).collect::<String>();
    let mut obj = list(&|p| format!("v {} {} {}\n", p.x, p.y, p.z));
    obj.extend((0..faces.len()).map(|k| format!("f {} {} {}\n", 3 * k + 1, 3 * k + 2, 3 * k + 3)));
    std::fs::write(at("cube.obj"), obj).unwrap();
    // This file is in centimetres, and a node moves the mesh.
    let numbers = list(&|p| format!("{} {} {} ", 100.0 * p.x - 5.0, 100.0 * p.y, 100.0 * p.z));
    let corners: String = (0..points.len()).map(|k| format!("{k} 0 ")).collect();
    let dae = format!(
        r##"<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
        <asset><unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
        <library_geometries><geometry id="g"><mesh><source id="s"><float_array id="f" count="{}">{numbers}</float_array></source>
        <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
        <triangles count="{}"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#n" offset="1"/>
        <p>{corners}</p></triangles></mesh></geometry></library_geometries>
        <library_visual_scenes><visual_scene id="sc"><node><translate>5 0 0</translate><node><instance_geometry url="#g"/></node></node>
        </visual_scene></library_visual_scenes><scene><instance_visual_scene url="#sc"/></scene></COLLADA>"##,
        3 * points.len(),
        faces.len()
    );
    std::fs::write(at("cube.dae"), dae).unwrap();
    for (file, scale) in [("cube.stl", "1 1 1"), ("cube.obj", "1 1 1"), ("cube.dae", "1 1 1"), ("cube.stl", "-1 2 0.5")]
    {
        let urdf = format!(
            r#"<robot name="r"><link name="base"><inertial><mass value="1"/>
            <inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>
            <collision><geometry><mesh filename="{file}" scale="{scale}"/></geometry></collision></link></robot>"#
        );
        std::fs::write(at("r.urdf"), urdf).unwrap();
        let read = robots::load(&at("r.urdf")).unwrap();
        let shape = &read.tree.bodies[0].shapes[0];
        assert!(read.warnings.is_empty(), "{:?}", read.warnings);
        assert!((shape.geometry.volume() - 0.048).abs() < 1e-6, "{file} {scale}: {}", shape.geometry.volume());
        let low = if scale == "1 1 1" { -0.3 } else { -0.15 };
        assert!((shape.lowest() - low).abs() < 1e-6, "{file} {scale}: {}", shape.lowest());
    }
    // Without its last face the surface is open: the convex hull is used instead, and a note says this.
    write_stl(&at("cube.stl"), &faces[..11], &Rotation3::identity());
    let text = std::fs::read_to_string(at("r.urdf")).unwrap().replace("-1 2 0.5", "1 1 1");
    std::fs::write(at("r.urdf"), text).unwrap();
    let read = robots::load(&at("r.urdf")).unwrap();
    assert!((read.tree.bodies[0].shapes[0].geometry.volume() - 0.048).abs() < 1e-6);
    assert!(read.warnings.iter().any(|w| w.contains("convex hull")), "{:?}", read.warnings);
}

/// Every unsupported element is named; none is ignored silently.
#[test]
fn unsupported_elements_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.xml");
    let text = std::fs::read_to_string(here("robots/sandcat.xml")).unwrap();
    let text = text.replace("<freejoint/>", r#"<freejoint/><site name="imu"/><camera name="eye"/>"#);
    let text = text.replace("<keyframe>", r#"<sensor><gyro site="imu"/></sensor><tendon><fixed name="t" stiffness="3"><joint joint="FL_knee" coef="1"/></fixed></tendon><keyframe>"#);
    let text = text.replace(
        r#"name="FL_knee" class="knee""#,
        r#"name="FL_knee" class="knee" stiffness="3" springref="0.5" margin="0.1""#,
    );
    std::fs::write(&path, text).unwrap();
    let read = robots::load(&path).unwrap();
    let knee = read.tree.joints().find(|j| j.name == "FL_knee").unwrap();
    assert_eq!(knee.spring, Some([3.0, 0.5]));
    let said = read.warnings.join("\n");
    for word in ["<site>", "<camera>", "<sensor>", "<tendon>", "margin"] {
        assert!(said.contains(word), "{word} is missing: {said}");
    }
}

#[test]
fn a_picture_shows_the_robot() {
    let folder = tempfile::tempdir().unwrap();
    let png = folder.path().join("sandcat.png");
    let robot = here("robots/sandcat.xml");
    let about = json(&["robot", robot.to_str().unwrap(), "--json", "--picture", png.to_str().unwrap()]);
    assert_eq!(about["touches_sand"]["shapes"].as_array().unwrap().len(), 9);
    let map = tiny_skia::Pixmap::load_png(&png).unwrap();
    assert_eq!((map.width(), map.height()), (960, 720));
    // Plates are red and sand is not; both are visible, and neither fills the picture.
    let red = |p: &&tiny_skia::PremultipliedColorU8| u32::from(p.red()) > 2 * u32::from(p.green()).max(60);
    let count = map.pixels().iter().filter(red).count();
    assert!((2_000..200_000).contains(&count), "{count}");
    for name in ["xplorer", "xplorer18"] {
        let about = json(&["robot", name, "--json"]);
        assert!(about["mass"].as_f64().unwrap() > 0.1 && about["touches_sand"]["plates"].as_u64().unwrap() > 100);
    }
}
