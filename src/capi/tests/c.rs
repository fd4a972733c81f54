//! The example in C gets the same numbers as Rust, and the texts of errors.

use sandgait_bodies::{Bodies, BodyPart, GroundOptions, Motions, SandGround, Strided};
use sandgait_sand::SandDescription;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The static library: cargo puts it next to this program.
fn library() -> PathBuf {
    let folder = std::env::current_exe().unwrap().parent().unwrap().to_owned();
    let files = std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().path());
    let own = |p: &PathBuf| p.file_name().unwrap().to_str().unwrap().starts_with("libsandgait_capi");
    let all = files.filter(|p| own(p) && p.extension().is_some_and(|e| e == "a"));
    all.max_by_key(|p| p.metadata().unwrap().modified().unwrap()).unwrap()
}

#[test]
fn the_example_in_c_has_the_same_numbers() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = std::env::temp_dir().join(format!("sandgait-capi-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let program = folder.join("example");
    let mut cc = Command::new("cc");
    cc.args(["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-I"]).arg(here).arg("-o").arg(&program);
    cc.arg(here.join("tests/example.c")).arg(library()).args(["-lm", "-lpthread", "-ldl"]);
    assert!(cc.status().unwrap().success());
    let output = Command::new(&program).output().unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<&str> = text.lines().collect();

    let sand = SandDescription::named("poppy-loose", "agarwal2023").unwrap();
    let sand = SandGround::new(sand, GroundOptions::default()).unwrap();
    let part = |text: &str, z: f64| BodyPart::named(text).unwrap().placed([0.0, 0.0, z], [1.0, 0.0, 0.0, 0.0]).unwrap();
    let ball = || part("sphere:radius=0.02", 0.0);
    let shank = vec![part("capsule:radius=0.01,height=0.2", 0.1), ball()];
    let bodies = Bodies::new(vec![("0".into(), vec![ball()]), ("1".into(), shank)], None).unwrap();
    let twice = |row: [f64; 3]| [row, row].concat();
    let (position, quaternion) = ([0.0, 0.0, -0.01, 1.0, 0.0, -0.01], [[1.0, 0.0, 0.0, 0.0]; 2].concat());
    let (velocity, spin) = (twice([0.05, 0.0, -0.1]), twice([0.0, 1.0, 0.0]));
    let rows = |numbers, width: usize| Strided { numbers, steps: [2 * width, width] };
    let motions = Motions {
        states: 1,
        position: rows(&position[..], 3),
        quaternion: rows(&quaternion[..], 4),
        velocity: rows(&velocity[..], 3),
        angular_velocity: rows(&spin[..], 3),
        travel: None,
    };
    let (mut wrench, mut drag) = ([0.0; 12], [0.0; 72]);
    bodies.wrench(&sand, &motions, 1, &mut wrench, Some(&mut drag)).unwrap();
    for (k, line) in lines[..2].iter().enumerate() {
        let found: Vec<f64> = line.split(' ').map(|x| x.parse().unwrap()).collect();
        let w = &wrench[6 * k..6 * k + 6];
        assert_eq!(found, [w[0], w[2], w[4], drag[36 * k + 14]], "body {k}");
        assert!(w[2] > 0.1);
    }
    assert_eq!(lines[2], "quaternion: of \"1\" in state 0 has length 2.0000, not 1");
    assert!(lines[3].contains("gravel"), "{}", lines[3]);
    assert_eq!(lines.len(), 4);
}
