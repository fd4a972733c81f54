//! Commands as a new user types them: a policy's folder says what it was trained for, options are given in one way,
//! typing errors get a suggestion, Ctrl-C keeps what was learnt, and readings by hand calibrate a sand.

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn sandgait(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sandgait")).args(arguments).output().unwrap()
}

fn text(arguments: &[&str]) -> String {
    let output = sandgait(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Exit code 2 and one line on stderr that contains `words`.
fn refused(arguments: &[&str], words: &[&str]) {
    let output = sandgait(arguments);
    let line = String::from_utf8(output.stderr).unwrap();
    assert_eq!((output.status.code(), line.lines().count()), (Some(2), 1), "{arguments:?}: {line}");
    for word in words {
        assert!(line.contains(word), "{arguments:?}: {line:?} lacks {word:?}");
    }
}

const TERRAIN: &str = "examples/policies/HexapodTerrain-ppo/policy.onnx";
const SANDCAT: &str = "examples/policies/LeggedVelocity-sandcat/policy.onnx";

#[test]
fn a_policy_brings_its_task_and_options() {
    let short = ["--seeds", "2", "--option", "max_episode_steps=10"];
    let table = text(&[&["evaluate", TERRAIN][..], &short].concat());
    assert!(table.contains("policy.onnx, sandgait/HexapodTerrain-v1"), "{table}");
    let report = text(&["bench", "--policy", TERRAIN, "--envs", "4", "--repeats", "5", "--seconds", "0.001"]);
    assert!(report.contains("sandgait/HexapodTerrain-v1") && report.contains("actions policy"), "{report}");
    // The folder stands for its policy, also where a policy is wanted for something else.
    let folder = Path::new(TERRAIN).parent().unwrap().to_str().unwrap();
    assert_eq!(text(&[&["evaluate", folder][..], &short].concat()), table);
    let report = text(&["bench", "--policy", folder, "--envs", "4", "--repeats", "5", "--seconds", "0.001"]);
    assert!(report.contains("sandgait/HexapodTerrain-v1"), "{report}");
    for command in ["evaluate", "play"] {
        refused(&[command, "src"], &["src/policy.onnx"]);
    }
    // Another task takes none of the training's options, and says so.
    let other = sandgait(&[&["evaluate", TERRAIN, "--task", "HexapodGait"][..], &short].concat());
    let said = String::from_utf8(other.stderr).unwrap();
    assert!(said.contains("the policy was trained in sandgait/HexapodTerrain-v1"), "{said}");
    // A policy of LeggedVelocity follows commands, which nobody has to know.
    refused(&["evaluate", SANDCAT, "--seeds", "9"], &["--seeds", "nine commands"]);
    refused(&["evaluate", SANDCAT, "--media", "poppy-clos"], &["ground", "did you mean \"poppy-close\"?"]);
    refused(&["evaluate", SANDCAT, "--strengths", "0"], &["strengths", "0 is outside"]);
    refused(&["evaluate", "standing", "--strengths", "2"], &["--strengths", "LeggedVelocity"]);
    refused(&["evaluate", TERRAIN, "--commands"], &["--commands", "HexapodTerrain"]);
    refused(&["play", SANDCAT, "--option", "grund=rigid"], &["did you mean \"ground\"?"]);
}

/// The nine commands of a kept policy, by its folder alone; a narrow range to the side gives no infinite error.
#[test]
fn commands_are_within_the_training() {
    let directory = tempfile::tempdir().unwrap();
    for file in ["policy.onnx", "settings.json"] {
        std::fs::copy(Path::new(SANDCAT).with_file_name(file), directory.path().join(file)).unwrap();
    }
    let policy = directory.path().join("policy.onnx");
    let (policy, csv) = (policy.to_str().unwrap(), directory.path().join("commands.csv"));
    let table = text(&["evaluate", policy, "--csv", csv.to_str().unwrap()]);
    assert!(table.contains("mean error") && !table.contains("inf"), "{table}");
    assert_eq!(std::fs::read_to_string(&csv).unwrap().lines().count(), 10);
    let narrow = "commands={\"lin_vel_y\": [-0.02, 0.02]}";
    let table = text(&["evaluate", policy, "--option", narrow, "--csv", csv.to_str().unwrap()]);
    assert!(!table.contains("inf") && !table.contains("NaN"), "{table}");
    assert_eq!(std::fs::read_to_string(&csv).unwrap().lines().count(), 8, "{table}");
}

/// One policy on several grounds: nine lines for each in the CSV; hard ground has no strength, and nominal sand gives the errors of an
/// evaluation without lists.
#[test]
fn a_policy_is_evaluated_on_several_grounds() {
    let directory = tempfile::tempdir().unwrap();
    let csv = directory.path().join("sands.csv");
    let csv = csv.to_str().unwrap();
    let table = text(&["evaluate", SANDCAT, "--media", "poppy-close,rigid", "--strengths", "1,4", "--csv", csv]);
    assert!(table.contains("mean error") && table.contains("strength"), "{table}");
    let rows: Vec<Vec<String>> =
        std::fs::read_to_string(csv).unwrap().lines().map(|l| l.split(',').map(str::to_owned).collect()).collect();
    assert_eq!((rows.len(), &*rows[0][2]), (28, "strength"));
    assert_eq!(
        [1, 10, 19].map(|k| (&*rows[k][0], &*rows[k][2])),
        [("poppy-close", "1"), ("poppy-close", "4"), ("rigid", "")]
    );
    let alone = directory.path().join("alone.csv");
    text(&["evaluate", SANDCAT, "--option", "ground=poppy-close", "--csv", alone.to_str().unwrap()]);
    let alone = std::fs::read_to_string(alone).unwrap();
    let of = |rows: &[Vec<String>]| rows.iter().map(|row| row[3..].join(",")).collect::<Vec<_>>();
    assert_eq!(of(&rows[1..10]), alone.lines().skip(1).collect::<Vec<_>>());
    assert_ne!(of(&rows[10..19]), of(&rows[1..10]));
}

#[test]
fn options_are_given_in_one_way() {
    let speed = |more: &[&str]| {
        let walk = text(&[&["walk", "--frequency", "2", "--json"][..], more].concat());
        serde_json::from_str::<serde_json::Value>(&walk).unwrap()["speed"].as_f64().unwrap()
    };
    assert!(speed(&["--option", "payload=0.2"]) < speed(&["--option", "payload=0"]));
    // An argument takes precedence.
    assert_eq!(speed(&["--leg", "C", "--option", "leg=L"]), speed(&["--option", "leg=C"]));
    refused(&["walk", "--frequency", "2", "--option", "command=1"], &["option", "command", "known: robot"]);
    let evaluate = ["evaluate", "standing", "--seeds", "2", "--option", "max_episode_steps=2"];
    let by_words = text(&[&evaluate[..], &["--option", "action_delay=0.02", "--option", "command=0.2"]].concat());
    let given = r#"{"action_delay": [0.02, 0.02], "command": [0.2, 0.2]}"#;
    assert_eq!(by_words, text(&[&evaluate[..], &["--options", given]].concat()));
    refused(&[&evaluate[..], &["--option", "sensors=[1]"]].concat(), &["sensors"]);
}

#[test]
fn typing_errors_get_a_suggestion() {
    for (arguments, meant) in [
        (&["tasks", "HexapodGate"][..], "sandgait/HexapodGait-v1"),
        (&["walk", "--frequency", "2", "--medium", "popy-loose"], "poppy-loose"),
        (&["walk", "--frequency", "2", "--robot", "xplorer81"], "xplorer18"),
        (&["walk", "--frequency", "2", "--law", "li2031"], "li2013"),
        (&["bench", "--option", "slope=5"], "slope_deg"),
        (&["bench", "--option", "weights={\"trackin\": 1}"], "tracking"),
        (&["train", "--set", "gama=0.9"], "gamma"),
        (&["evaluate", "tripot"], "tripod[:HZ]"),
        (&["robot", "go3"], "go1"),
    ] {
        refused(arguments, &["is unknown", &format!("did you mean \"{meant}\"?")]);
    }
}

/// Ctrl-C in a training leaves the policy of the last update, and the exit code is that of Ctrl-C.
#[test]
fn ctrl_c_keeps_the_policy() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("run");
    let small = ["--set", "n_envs=16", "--set", "n_steps=16", "--set", "batch_size=64", "--threads", "1"];
    let mut command = Command::new(env!("CARGO_BIN_EXE_sandgait"));
    command.args(["train", "--timesteps", "100000000", "--out"]).arg(&out).args(small);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let start = Instant::now();
    // A point of the curve comes after some updates.
    let learnt = || std::fs::read_to_string(out.join("curve.csv")).is_ok_and(|curve| curve.lines().count() > 1);
    while !learnt() {
        assert!(start.elapsed() < Duration::from_secs(120), "the training does not begin");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{said}");
    let last = said.lines().last().unwrap_or_default();
    assert!(last.contains("policy.onnx") && last.ends_with("go on with --resume"), "{said}");
    assert!(text(&["evaluate", out.join("policy.onnx").to_str().unwrap(), "--seeds", "2"]).contains("HexapodGait"));
}

/// Ten readings of a plate of 9.5 cm² in a sand of this ζ [N/cm³].
fn readings(zeta: f64) -> String {
    let line =
        |k: u32| format!("{},{:.3}\n", 5 * k, zeta * 1e6 * 5e-3 * f64::from(k) * 9.5e-4 + 0.02 * f64::from(k % 3));
    format!("depth [mm],force [N]\n{}", (1..=10).map(line).collect::<String>())
}

#[test]
fn readings_by_hand_calibrate_a_sand() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let zetas = [0.27, 0.30, 0.33];
    let files: Vec<String> = (0..3).map(|k| path(&format!("push{k}.csv"))).collect();
    for (file, zeta) in files.iter().zip(zetas) {
        std::fs::write(file, readings(zeta)).unwrap();
    }
    let one = text(&["calibrate", &files[1], "--out", &path("one.toml")]);
    assert!(one.contains("10 samples") && one.contains("one push"), "{one}");
    let all: Vec<&str> = std::iter::once("calibrate").chain(files.iter().map(String::as_str)).collect();
    let study = text(&[&all[..], &["--json", "--out", &path("sand.toml")]].concat());
    let study: serde_json::Value = serde_json::from_str(&study).unwrap();
    let size = &study["sizes"][0];
    let end = |k: usize| size["zeta_interval"][k].as_f64().unwrap();
    // The interval of the mean of three pushes that scatter by 10 %.
    assert_eq!(size["pushes"], 3);
    assert!(end(0) < 0.27 && end(1) > 0.33 && size["repeatability_percent"].as_f64().unwrap() > 9.0, "{size}");
    // The sand is one that other commands take.
    for sand in ["one.toml", "sand.toml"] {
        assert!(text(&["walk", "--frequency", "2", "--sand", &path(sand)]).contains("m/s"));
        text(&["bench", "--option", &format!("sand={}", path(sand)), "--repeats", "5", "--seconds", "0.001"]);
    }
    let written = std::fs::read_to_string(path("sand.toml")).unwrap();
    assert!(written.contains("from 3 pushes") && written.contains("push2.csv"), "{written}");
    // Pushes of one file without sizes are of the plate of --area.
    let trials = (0..3).flat_map(|k| {
        let rows: Vec<String> = readings(zetas[k]).lines().skip(1).map(|row| format!("{k},{row}\n")).collect();
        rows
    });
    std::fs::write(path("all.csv"), format!("trial,depth [mm],force [N]\n{}", trials.collect::<String>())).unwrap();
    let by_trial = text(&["calibrate", &path("all.csv"), "--area", "0.00095", "--json"]);
    let by_trial: serde_json::Value = serde_json::from_str(&by_trial).unwrap();
    assert_eq!(by_trial["sizes"], study["sizes"]);
    refused(&["calibrate", &files[0], &path("all.csv")], &["all.csv", "without a column trial"]);
    refused(&["calibrate", &files[0], "--area", "5"], &["area", "[1e-7, 1]"]);
    // Several pushes in one file are not taken for one.
    let run = std::fs::read_to_string(path("all.csv")).unwrap().replacen("trial", "Run", 1);
    std::fs::write(path("run.csv"), run).unwrap();
    refused(&["calibrate", &path("run.csv")], &["run.csv", "begins again", "column trial"]);
}
