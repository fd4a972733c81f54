//! Sand that remembers, as users meet it: options of tasks, snapshots, and paths on the command line.

use sandgait::env::episode::Episode;
use sandgait::env::registry::Blueprint;
use sandgait::env::shard::Shard;
use sandgait::sim::pose::Pose;
use serde_json::{Value, json};
use std::process::{Command, Output};

const GAIT: &str = "sandgait/HexapodGait-v1";

fn sandgait(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sandgait")).args(arguments).output().unwrap()
}

fn shard(task: &str, options: Value, envs: usize) -> (Blueprint, Shard) {
    let blueprint = Blueprint::new(task, options).unwrap();
    let mut shard = Shard::new(&blueprint, envs).unwrap();
    shard.reset(|_| true, Some(&(0..envs as u64).collect::<Vec<_>>()), |_| None);
    (blueprint, shard)
}

fn steps(shard: &mut Shard, count: usize, action: f32) {
    let actions = vec![action; shard.envs() * shard.actions()];
    (0..count).for_each(|_| shard.step(&actions));
}

const TASKS: [(&str, &str); 4] = [
    (GAIT, r#"{"memory": true}"#),
    ("sandgait/HexapodLegs-v1", r#"{"memory": true}"#),
    ("sandgait/HexapodTerrain-v1", r#"{"memory": true, "randomize": {"footprint": [0.0, 0.0]}}"#),
    ("sandgait/LeggedVelocity-v1", r#"{"memory": true}"#),
];

/// A contact force is that of the sand as it was left by the robot, not of fresh sand: `tree` computes it for the sensor.
#[test]
fn contact_forces_are_those_of_used_sand() {
    let options =
        json!({"memory": true, "ground": "poppy-loose", "sensors": {"contact_force": {}}, "curriculum": null});
    let (blueprint, mut shard) = shard("sandgait/LeggedVelocity-v1", options, 2);
    let columns = &blueprint.task.spec().observation;
    let forces: Vec<_> = (0..columns.len()).filter(|k| columns[*k].name.starts_with("contact force")).collect();
    assert_eq!(forces.len(), 4);
    let mut differs = false;
    for step in 0..100 {
        steps(&mut shard, 1, if step % 16 < 8 { 1.0 } else { -1.0 });
        let (view, row) = (shard.look(1, false), &shard.rows.observations[columns.len()..]);
        let whole = view.whole_state();
        let [used, fresh] = [&whole, view.state].map(|state| Pose::of(view.model, state, view.footing));
        for (k, foot) in forces.iter().zip(&view.model.tree.as_ref().unwrap().stance.feet) {
            let [used, fresh] = [&used, &fresh].map(|pose| pose.force_on(view.model, *foot).z);
            assert!((f64::from(row[*k]) - used).abs() <= 1e-5 * used.abs(), "{step}: {} {used}", row[*k]);
            differs |= (used - fresh).abs() > 0.1 * used.abs();
        }
    }
    assert!(differs, "the prints have no effect");
}

/// In each task robots leave prints, and a restored environment continues bit-identically beside others.
#[test]
fn prints_are_left_and_saved() {
    for (task, options) in TASKS {
        let (blueprint, mut one) = shard(task, serde_json::from_str(options).unwrap(), 3);
        steps(&mut one, 40, 0.3);
        let sand = one.look(1, false).whole_state().sand.expect("no sand");
        let deepest = sand.grid.cells().fold(0.0_f64, |deep, (_, h)| deep.min(h));
        assert!(deepest < -1e-3, "{task}: {deepest}");
        let saved = one.save(1);
        let resumed = Episode::resume(&saved, &blueprint.task).unwrap();
        let (_, mut other) = shard(task, serde_json::from_str(options).unwrap(), 5);
        steps(&mut other, 7, -0.5);
        other.restore(4, &resumed);
        steps(&mut one, 30, 0.3);
        steps(&mut other, 30, 0.3);
        assert_eq!(one.state(1), other.state(4), "{task}");
        assert_eq!(one.look(1, false).sand, other.look(4, false).sand, "{task}");
        // Crafted or foreign sand is refused.
        for sand in [None, Some(Vec::new()), saved.sand.clone().map(|s| [s, vec![0]].concat())] {
            let mut crafted = saved.clone();
            crafted.sand = sand;
            assert!(Episode::resume(&crafted, &blueprint.task).is_err(), "{task}");
        }
    }
    let (blueprint, plain) = shard(GAIT, Value::Null, 1);
    let mut crafted = plain.save(0);
    crafted.sand = Some(vec![0; 12_000]);
    assert!(plain.look(0, false).sand.is_none() && Episode::resume(&crafted, &blueprint.task).is_err());
}

/// A step that is held, and a push, leave the sand as it is.
#[test]
fn sand_outlives_held_steps_and_pushes() {
    let (_, mut held) = shard(GAIT, json!({"memory": true}), 2);
    steps(&mut held, 25, 0.5);
    let before = held.look(0, false).sand.cloned();
    let actions = vec![0.5; 2 * held.actions()];
    held.step_but(&actions, |i| i == 0);
    assert_eq!(held.look(0, false).sand.cloned(), before);
    assert_ne!(held.look(1, false).sand.cloned(), before);
    let often = json!({"memory": true, "domain_rand": {"push_interval": 0.1}});
    let (_, mut pushed) = shard("sandgait/LeggedVelocity-v1", often, 1);
    steps(&mut pushed, 30, 0.0);
    let sand = pushed.look(0, false).sand.cloned().unwrap();
    steps(&mut pushed, 10, 0.0);
    let now = pushed.look(0, false).sand.cloned().unwrap();
    let deepest = |s: &sandgait::sand::memory::Moved| s.grid.cells().fold(0.0_f64, |deep, (_, h)| deep.min(h));
    assert!(deepest(&now) <= 0.5 * deepest(&sand) && deepest(&sand) < -1e-3, "{} {}", deepest(&sand), deepest(&now));
}

/// Combinations without meaning are refused in one line that says what to do.
#[test]
fn wrong_options_are_named() {
    let sand = sandgait::sand::SandDescription::named("poppy-loose", "li2013").unwrap();
    let mut used = sand.clone();
    used.mechanisms.footprint = 0.3;
    let used = used.to_toml().unwrap();
    for (task, options, word) in [
        (GAIT, json!({"memory": true, "engine": "rapier"}), "rapier"),
        ("sandgait/HexapodRocks-v1", json!({"memory": true}), "rapier"),
        ("sandgait/HexapodTerrain-v1", json!({"memory": true}), "randomize.footprint"),
        ("sandgait/LegStroke-v0", json!({"memory": true}), "no such option"),
        ("sandgait/LeggedVelocity-v1", json!({"memory": true, "ground": "rigid"}), "flat sand"),
        ("sandgait/LeggedVelocity-v1", json!({"memory": true, "ground": "dunes"}), "flat sand"),
        ("sandgait/LeggedVelocity-v1", json!({"memory": true, "ground": "mixed"}), "flat sand"),
        ("sandgait/LeggedVelocity-v1", json!({"memory": true, "ground": "any"}), "flat sand"),
        (GAIT, json!({"memory": true, "sand": used}), "footprint"),
        (GAIT, json!({"memory": 1}), "memory"),
    ] {
        let error = Blueprint::new(task, options.clone()).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains("memory") && error.contains(word) && error.lines().count() == 1, "{options}: {error}");
    }
}

/// Sand that remembers takes at most 16 KiB more for each environment. Twice as much is reserved, because a rollout
/// keeps a copy.
#[test]
fn memory_has_a_price() {
    for (task, options) in TASKS {
        let with: Value = serde_json::from_str(options).unwrap();
        let mut without = with.clone();
        without["memory"] = false.into();
        let [with, without] = [with, without].map(|o| Blueprint::new(task, o).unwrap());
        let bytes = with.task.model().sand_bytes();
        assert!((8_000..16 << 10).contains(&bytes) && without.task.model().sand_bytes() == 0, "{task}: {bytes}");
        assert!(with.bytes_per_env() >= without.bytes_per_env() + 2 * bytes, "{task}");
    }
}

const FOOT: &str = "box:length=0.04,width=0.03,height=0.02";

/// Rows of a path that presses twice at the same place.
fn presses() -> String {
    let mut text = String::from("trial,t [ms],x,y,vz,depth [mm]\n");
    for (trial, x) in [("a", 0.0), ("b", 0.5)] {
        for pass in 0..2 {
            for k in 0..60 {
                let (t, depth) = (1000 * pass + 10 * k, if k < 30 { k - 2 } else { 57 - k });
                text += &format!("{trial},{t},{x},0,{},{depth}\n", if k < 30 { -0.1 } else { 0.1 });
            }
        }
    }
    text
}

#[test]
fn a_path_presses_its_print_again() {
    let directory = tempfile::tempdir().unwrap();
    let [rows, out, heights] =
        ["rows.csv", "out.csv", "heights.csv"].map(|n| directory.path().join(n).to_str().unwrap().to_owned());
    std::fs::write(&rows, presses()).unwrap();
    let common = ["intrude", "--body", FOOT, "--trials", &rows, "--csv", &out];
    let run = |more: &[&str]| {
        let done = sandgait(&[&common, more].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let text = std::fs::read_to_string(&out).unwrap();
        let header: Vec<String> = text.lines().next().unwrap().split(',').map(str::to_owned).collect();
        let at = header.iter().position(|name| name == "Fz").unwrap();
        text.lines().skip(1).map(|l| l.split(',').nth(at).unwrap().parse::<f64>().unwrap()).collect::<Vec<_>>()
    };
    let used = run(&["--memory", "--surface", &heights]);
    let fresh = run(&[]);
    // 5 mm and 25 mm deep, first and second press.
    let at = |forces: &[f64], pass: usize, k: usize| forces[60 * pass + k];
    assert!((at(&used, 0, 7) - at(&fresh, 0, 7)).abs() < 1e-3 * at(&fresh, 0, 7));
    assert!(at(&used, 1, 7) < 0.3 * at(&used, 0, 7), "the print is not empty");
    assert!(at(&used, 1, 27) > 0.9 * at(&used, 0, 27), "the sand in the print is not stronger");
    // The second trial begins on fresh sand, half a metre away.
    assert!(used[..120].iter().zip(&used[120..]).all(|(a, b)| (a - b).abs() < 0.02 * a.abs().max(0.5)));
    let surface = std::fs::read_to_string(&heights).unwrap();
    assert!(surface.starts_with("trial,x,y,height\na,") && surface.contains("\nb,"), "{surface:.80}");
}

#[test]
fn wrong_paths_are_one_line() {
    let directory = tempfile::tempdir().unwrap();
    let rows = directory.path().join("rows.csv");
    let out = directory.path().join("out.csv");
    let [file, csv] = [&rows, &out].map(|p| p.to_str().unwrap());
    let good = "trial,t,vz,depth\na,0,-0.1,0.01\na,0.1,-0.1,0.02\n";
    for (text, more, word) in [
        ("vz,depth\n-0.1,0.01\n", &["--memory"][..], "column t"),
        ("trial,t,vz,depth\na,1,-0.1,0.01\na,0,-0.1,0.02\n", &["--memory"], "before"),
        ("trial,t,vz,depth\na,0,-1,0\nb,0,-1,0\na,1,-1,0\n", &["--memory"], "comes again"),
        ("t,vx,wx,depth\n0,0.1,1,0.01\n", &["--memory"], "round"),
        (good, &["--memory", "--repose-deg", "80"], "repose-deg"),
        (good, &["--memory", "--cell", "0"], "cell"),
        (good, &["--repose-deg", "30"], "--memory"),
        (good, &["--surface", "s.csv"], "--memory"),
    ] {
        std::fs::write(&rows, text).unwrap();
        let done = sandgait(&[&["intrude", "--body", FOOT, "--trials", file, "--csv", csv], more].concat());
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        let refused = done.status.code() == Some(2) && said.lines().count() == 1 && said.contains(word);
        assert!(refused && !out.exists(), "{more:?}: {said}");
    }
}
