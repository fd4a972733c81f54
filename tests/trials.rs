//! `intrude --body … --trials …` and `validate` on the command line.

use std::process::{Command, Output};

fn sandgait(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sandgait")).args(arguments).output().unwrap()
}

const WHEEL: &str = "cylinder:radius=0.0625,width=0.06";
const SAND: &str = "tests/data/real_wheel/sand_smooth.toml";

#[test]
fn rows_come_back_with_forces_depth_and_status() {
    let directory = tempfile::tempdir().unwrap();
    let [rows, out] = ["rows.csv", "out.csv"].map(|n| directory.path().join(n).to_str().unwrap().to_owned());
    std::fs::write(&rows, "name,vx,wy,depth [mm],load,Fx\na,0.01,0.1,,20,3\nb,0.01,0.1,20,,4\nc,0.01,0,,1e5,1\n")
        .unwrap();
    let done = sandgait(&["intrude", "--body", WHEEL, "--trials", &rows, "--sand", SAND, "--csv", &out]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert!(String::from_utf8_lossy(&done.stdout).contains("3 rows, 1 without equilibrium"));
    let csv = std::fs::read_to_string(&out).unwrap();
    let lines: Vec<Vec<&str>> = csv.lines().map(|l| l.split(',').collect()).collect();
    assert_eq!(lines[0].join(","), "name,vx,wy,load,Fx_given,Fx,Fy,Fz,Tx,Ty,Tz,depth,status");
    let number = |row: usize, column: usize| lines[row][column].parse::<f64>().unwrap();
    assert!((number(1, 7) - 20.0).abs() < 1e-4 && (number(2, 11) - 0.02).abs() < 1e-9, "{csv}");
    assert_eq!([1, 2, 3].map(|k| lines[k][12]), ["ok", "ok", "no_equilibrium"]);
    // A rougher surface changes the force.
    let rough =
        sandgait(&["intrude", "--body", WHEEL, "--trials", &rows, "--sand", SAND, "--mu-s", "0.2", "--csv", &out]);
    assert!(rough.status.success() && std::fs::read_to_string(&out).unwrap() != csv);
}

#[test]
fn wrong_use_is_one_line() {
    let directory = tempfile::tempdir().unwrap();
    let rows = directory.path().join("rows.csv");
    let file = rows.to_str().unwrap();
    let contents = ["vx,depth,load\n0.1,0.01,5\n", "vx,depth\n0.1,\n", "vx,load\n0.1,-3\n", "vx,depth\n1e9,0.01\n"];
    for text in contents {
        std::fs::write(&rows, text).unwrap();
        let done = sandgait(&["intrude", "--body", WHEEL, "--trials", file]);
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(done.status.code() == Some(2) && said.lines().count() == 1 && said.contains("row 2"), "{text}: {said}");
    }
    std::fs::write(&rows, "vx,depth\n0.1,0.01\n").unwrap();
    // A term is taken as linear in the depth of a plate; with other groups than directions it would not be.
    for (group, code) in [("froude", 2), ("cos_attack", 0)] {
        let sand = directory.path().join("sand.toml");
        let term = format!(
            "[[term]]\non = \"law\"\ncoefficient = 0.2\ngroups = {{ {group} = 1.0 }}\nrange = {{ {group} = [0.0, 1.0] }}\n"
        );
        std::fs::write(&sand, std::fs::read_to_string(SAND).unwrap() + &term).unwrap();
        let done = sandgait(&["intrude", "--body", WHEEL, "--trials", file, "--sand", sand.to_str().unwrap()]);
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(code), "{group}: {said}");
        assert!(code == 0 || said.lines().count() == 1 && said.contains("group froude"), "{said}");
    }
    for more in [["--plate-size", "1e-7"], ["--mu-s", "0"], ["--shape", "L"], ["--omega", "1"]] {
        let done = sandgait(&["intrude", "--body", WHEEL, "--trials", file, more[0], more[1]]);
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(done.status.code() == Some(2) && said.lines().count() == 1, "{more:?}: {said}");
    }
}

/// Nine measured pushes of three discs into one sand: the pressure grows with depth and with the disc's size, and the
/// output says so.
#[test]
fn measured_discs_are_compared() {
    let discs = "tests/data/real_wheel/discs.csv";
    let done = sandgait(&["calibrate", discs, "--json"]);
    let warnings = String::from_utf8(done.stderr).unwrap();
    assert!(done.status.success() && warnings.contains("does not apply"), "{warnings}");
    let said: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(said["law"], "power_and_size");
    let [n, q] = ["depth_exponent", "size_exponent"].map(|name| said[name]["value"].as_f64().unwrap());
    assert!((1.2..1.5).contains(&n) && (0.8..1.3).contains(&q), "{n} {q}");
    let of = |law: &str| said["laws"].as_array().unwrap().iter().find(|l| l["law"] == law).unwrap();
    assert!(of("proportional")["other_size_percent"].as_f64() > of("power_and_size")["other_size_percent"].as_f64());

    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("pushes.csv");
    let text = std::fs::read_to_string(discs).unwrap();
    for (what, text, option) in [
        ("two sizes", text.replacen("large01,0.06", "large01,0.07", 1), ["--json", "--json"]),
        ("blank in 46 of", text.replace("large01,", ","), ["--json", "--json"]),
        ("--area", text.clone(), ["--area", "0.001"]),
        ("more than all", text.clone(), ["--compliance", "0.5"]),
    ] {
        std::fs::write(&path, text).unwrap();
        let options = if option[0] == option[1] { &option[..1] } else { &option[..] };
        let done = sandgait(&[&["calibrate", path.to_str().unwrap()], options].concat());
        let line = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(done.status.code() == Some(2) && line.lines().count() == 1 && line.contains(what), "{what}: {line}");
    }
}

#[test]
fn the_scoreboard_is_written_and_names_its_worst() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("board");
    let done = sandgait(&["validate", "--out", out.to_str().unwrap()]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let said = String::from_utf8(done.stdout).unwrap();
    assert!(said.starts_with("Largest errors without a fit on the wheels: locked wheel, slip ratio −1"), "{said}");
    let rows = std::fs::read_to_string(out.join("validation_rows.csv")).unwrap();
    // 126 rows at slip angles up to 60°, in each of three comparisons, and 36 of the smooth wheel at positive slip ratios.
    assert_eq!(rows.lines().count(), 1 + 3 * 126 + 36);
    // Free flight differs from pinocchio and MuJoCo by rounding only.
    let flights = said.lines().filter(|l| l.contains("| pinocchio ") || l.contains("| MuJoCo "));
    let off: Vec<f64> = flights.map(|l| l.split('|').nth(4).unwrap().trim().parse().unwrap()).collect();
    assert!(off.len() == 5 && off.iter().all(|percent| *percent < 1e-7), "{off:?}");
    for name in ["validation.md", "images/validation_0.svg", "images/validation_3.svg"] {
        assert!(out.join(name).metadata().unwrap().len() > 1000, "{name}");
    }
    let missing = sandgait(&["validate", "--data", directory.path().to_str().unwrap()]);
    assert_eq!(missing.status.code(), Some(2));
}

/// A user's own folder of measurements: the page shows the scores by its description.
#[test]
fn a_folder_of_ones_own_is_scored() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join("mine");
    std::fs::create_dir(&folder).unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
    let description = r#"title = "A box in our sand"
source = "our own laboratory"
licence = "CC0"
most_slip_angle_deg = 45.0

[[intruder]]
name = "box"
body = "box:length=0.1,width=0.06,height=0.04"
rows = "box.csv"
sand = "sand.toml"
"#;
    write("validation.toml", description);
    std::fs::copy(SAND, folder.join("sand.toml")).unwrap();
    // The "measured" values are the program's own, with Fz increased by a tenth.
    write("trials.csv", "vx,vy,wy,depth\n0.01,0,0,0.01\n0.01,-0.002,0,0.015\n0.01,-0.02,0,0.015\n");
    let [trials, forces, sand] = ["trials.csv", "forces.csv", "sand.toml"].map(|n| folder.join(n));
    let body = ["intrude", "--body", "box:length=0.1,width=0.06,height=0.04", "--trials", trials.to_str().unwrap()];
    let done = sandgait(&[&body[..], &["--sand", sand.to_str().unwrap(), "--csv", forces.to_str().unwrap()]].concat());
    assert!(done.status.success());
    let mut rows = String::from("vx,vy,wy,depth,Fx,Fy,Fz,slip_angle_deg,slip\n");
    let angles = ["0", "11", "63"];
    for (line, angle) in std::fs::read_to_string(&forces).unwrap().lines().skip(1).zip(angles) {
        let cells: Vec<&str> = line.split(',').collect();
        let [x, y, z] = [3, 4, 5].map(|k| cells[k].parse::<f64>().unwrap());
        rows += &format!("{},{},{},{},{x},{y},{},{angle},-1\n", cells[0], cells[1], cells[2], cells[9], 1.1 * z);
    }
    write("box.csv", &rows);
    let out = directory.path().join("board");
    let done = sandgait(&["validate", "--data", folder.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let page = std::fs::read_to_string(out.join("validation.md")).unwrap();
    assert!(page.contains("## A box in our sand") && page.contains("our own laboratory") && page.contains("CC0"));
    // Two rows count, because the third is beyond 45°. Fx and Fy are right; Fz is too small by 1/11 of the measured
    // one.
    let all = page.lines().find(|l| l.starts_with("| all ")).unwrap();
    let cells: Vec<&str> = all.split('|').map(str::trim).collect();
    assert_eq!(cells[2], "2");
    let value = |k: usize| cells[k].split(' ').next().unwrap().parse::<f64>().unwrap();
    assert!(value(3) == 0.0 && value(4) == 0.0 && (9.0..9.4).contains(&value(5)), "{all}");
    for (text, says) in [
        (description.replace("box.csv", "none.csv"), "none.csv"),
        (description.replace("source", "origin"), "validation.toml"),
        (description.replace("length=0.1", "length=-1"), "length"),
    ] {
        write("validation.toml", &text);
        let done = sandgait(&["validate", "--data", folder.to_str().unwrap()]);
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(done.status.code() == Some(2) && said.lines().count() == 1 && said.contains(says), "{said}");
    }
}
