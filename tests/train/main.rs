//! `sandgait train` on the command line: wrong input is refused, a stopped training and a killed server leave a
//! checkpoint, and a resumed training gives the same bits.

mod cuts;
mod servers;

use sandgait::env::registry::Blueprint;
use sandgait::policy::Network;
use sandgait::progress::{Progress, Silent};
use sandgait::train::{Hyperparameters, TrainingRequest};
use sandgait::{Error, Result};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Mutex;

fn train(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sandgait")).arg("train").args(arguments).output().unwrap()
}

/// Checks for exit code 2 and returns the one line on stderr.
fn one_line(arguments: &[&str]) -> String {
    let output = train(arguments);
    let line = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
    assert!(output.stdout.is_empty() && line.ends_with('\n') && line.lines().count() == 1, "{arguments:?}: {line:?}");
    line
}

#[test]
fn wrong_settings_are_one_line_and_write_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (out, file) = (path("out"), path("broken.yml"));
    std::fs::write(&file, "sandgait/HexapodGait-v1: [").unwrap();
    for (arguments, words) in [
        (&["--set", "gama=0.9"] as &[&str], "setting \"gama\" is unknown"),
        (&["--set", "n_envs=0"], "n_envs: 0 is outside [1, "),
        (&["--set", "n_envs=4", "--set", "n_steps=4"], "batch_size: 1024 is more than n_envs · n_steps = 16"),
        (&["--set", "learning_rate=nan"], "learning_rate"),
        (&["--timesteps", "0"], "--timesteps: 0 is outside"),
        (&["--seconds", "-1"], "seconds: -1 is outside [0.001, 10000000]"),
        (&["--seconds", "nan"], "seconds: NaN is outside [0.001, 10000000]"),
        (&["--seconds", "1e400"], "seconds: inf is outside [0.001, 10000000]"),
        (&["--set", "seconds=nan"], "seconds: NaN is outside"),
        (&["--threads", "5000"], "threads: 5000 is outside [0, 1024]"),
        (&["--seed", "99999999999"], "seed: 99999999999 is outside"),
        (&["--task", "Hexapod"], "sandgait: task \"Hexapod\" is unknown; did you mean \"sandgait/HexapodGait-v1\"?"),
        (&["--option", "leg=Q"], "leg"),
        (&["--option", "legs=L"], "legs"),
        (&["--hyperparameters", &file], "broken.yml: YAML: "),
        (&["--hyperparameters", "/none.yml"], "/none.yml: "),
        (&["--resume"], "checkpoints: there is no checkpoint to go on from"),
        (&["--address", "nowhere"], "--address: \"nowhere\" is neither host:port nor unix:/path"),
        (&["--token-file", &file], "--address"),
        (&["--address", "192.0.2.1:1", "--token-file", &file], "it would be sent to 192.0.2.1:1 without encryption"),
    ] {
        let line = one_line(&[arguments, &["--out", &out]].concat());
        assert!(line.contains(words), "{line}");
        assert!(!Path::new(&out).exists(), "{arguments:?} wrote something");
    }
}

#[test]
fn files_other_than_checkpoints_are_refused_and_kept() {
    let directory = tempfile::tempdir().unwrap();
    let checkpoints = directory.path().join("checkpoints");
    std::fs::create_dir(&checkpoints).unwrap();
    let out = directory.path().to_str().unwrap();
    let settings = ["--set", "n_envs=16", "--set", "n_steps=4", "--set", "batch_size=64"];
    for content in [b"" as &[u8], b"{}", &[0xff; 64], &[0; 4096]] {
        let file = checkpoints.join("64.safetensors");
        std::fs::write(&file, content).unwrap();
        let line = one_line(&[&settings[..], &["--resume", "--out", out]].concat());
        assert!(line.contains("64.safetensors: "), "{line}");
        assert_eq!(std::fs::read(&file).unwrap(), content);
    }
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1, "nothing was written");
}

/// The learning rate is far too large.
#[test]
fn a_loss_that_is_not_a_number_ends_in_one_line_with_a_checkpoint() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("out");
    let settings = ["n_envs=16", "n_steps=4", "batch_size=64", "learning_rate=1000", "normalize_advantage=false"];
    let mut arguments = vec!["--timesteps", "640000", "--out", out.to_str().unwrap(), "--set", "max_grad_norm=1e9"];
    settings.iter().for_each(|setting| arguments.extend(["--set", setting]));
    let line = one_line(&arguments);
    assert!(line.contains("loss or gradient is not a number after"), "{line}");
    let kept = std::fs::read_dir(out.join("checkpoints")).unwrap().count();
    assert_eq!(kept, usize::from(line.contains("go on with --resume")), "{line}");
    assert!(!out.join("policy.onnx").exists());
}

/// A training with sixteen environments and `timesteps` steps that writes to `out`.
fn request(task: &str, out: &Path, timesteps: u64, changes: &Value) -> TrainingRequest {
    let mut entry = json!({
        "n_envs": 16, "n_steps": 8, "n_timesteps": timesteps, "batch_size": 64, "n_epochs": 2, "normalize": true,
        "mirror": true, "learning_rate": "lin_1e-3", "policy_kwargs": {"net_arch": [16]},
    });
    let entry = entry.as_object_mut().unwrap();
    entry.extend(changes.as_object().unwrap().clone());
    TrainingRequest {
        task: task.into(),
        options: json!({"max_episode_steps": 30}),
        external: None,
        settings: Hyperparameters::from_entry(entry).unwrap(),
        seed: 3,
        threads: 2,
        out: out.into(),
        resume: false,
        start_from: None,
        checkpoint_every: 1_000_000,
        connect: None,
    }
}

/// Stops a training at the report after a number of updates, and keeps the last reported share.
struct Stop(Mutex<(usize, f64)>);

impl Progress for Stop {
    fn report(&self, done: f64, _: &str) -> Result<()> {
        let mut state = self.0.lock().unwrap();
        let (left, last) = *state;
        if left == 0 {
            return Err(Error::Cancelled("stopped".into()));
        }
        *state = (left - usize::from(done > last), done);
        Ok(())
    }
}

/// The policy's bytes, and the learning curve without its times.
fn result(out: &Path) -> (Vec<u8>, Vec<String>) {
    let curve = std::fs::read_to_string(out.join("curve.csv")).unwrap();
    let line = |line: &str| line.split(',').step_by(2).collect::<Vec<_>>().join(",");
    (std::fs::read(out.join("policy.onnx")).unwrap(), curve.lines().map(line).collect())
}

/// A training that is stopped at any point and resumed gives the same policy and curve, to the bit, as one without a
/// stop.
#[test]
fn a_resumed_training_gives_the_same_bits() {
    for (task, changes) in [
        ("sandgait/HexapodGait-v1", json!({})),
        ("sandgait/HexapodTerrain-v1", json!({"normalize": false})),
        ("sandgait/LegStroke-v0", json!({"mirror": false})),
    ] {
        let directory = tempfile::tempdir().unwrap();
        let [whole, parts] = ["whole", "parts"].map(|name| directory.path().join(name));
        let options = if task.contains("Stroke") { json!({}) } else { json!({"max_episode_steps": 30}) };
        let of = |out: &Path, resume: bool| TrainingRequest {
            options: options.clone(),
            resume,
            ..request(task, out, 1280, &changes)
        };
        of(&whole, false).run(&Silent).unwrap();
        for (k, updates) in [3, 4].into_iter().enumerate() {
            let stopped = of(&parts, k > 0).run(&Stop(Mutex::new((updates, 0.0))));
            let Err(Error::Cancelled(why)) = stopped else { panic!("{task}: not stopped") };
            assert!(why.contains("is kept in") && why.ends_with("go on with --resume"), "{why}");
            // The policy of the last update is there.
            let policy = parts.join("policy.onnx");
            assert!(why.contains(policy.to_str().unwrap()), "{why}");
            let spec = Blueprint::new(task, options.clone()).unwrap();
            Network::new(&std::fs::read(policy).unwrap(), spec.task.spec()).unwrap();
        }
        let outcome = of(&parts, true).run(&Silent).unwrap();
        assert!(outcome.notices.is_empty(), "{task}: {:?}", outcome.notices);
        assert!(result(&whole) == result(&parts), "{task}");
    }
}

/// A training with `start_from` begins with the networks and the normalisation of another training.
#[test]
fn a_training_starts_from_what_another_has_learnt() {
    let directory = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| directory.path().join(name));
    let of = |out: &Path, start_from: Option<PathBuf>, changes: Value| TrainingRequest {
        start_from,
        ..request("sandgait/HexapodGait-v1", out, 256, &changes)
    };
    let slow = json!({"learning_rate": 1e-12});
    let before = of(&first, None, json!({})).run(&Silent).unwrap().learnt;
    let policy = first.join("policy.safetensors");
    let after = of(&second, Some(policy.clone()), slow).run(&Silent).unwrap().learnt;
    let apart =
        |other: &[f32]| before.parameters.iter().zip(other).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    assert!(apart(&after.parameters) < 1e-6, "{}", apart(&after.parameters));
    assert_eq!(after.steps, 256);
    assert!(after.normal.unwrap().observations.count > before.normal.unwrap().observations.count);
    let refused = |request: TrainingRequest| request.run(&Silent).err().unwrap().to_string();
    let third = directory.path().join("third");
    let other = of(&third, Some(policy.clone()), json!({"policy_kwargs": {"net_arch": [8]}}));
    assert!(refused(other).contains("policy.safetensors"));
    let both = TrainingRequest { resume: true, ..of(&second, Some(policy), json!({})) };
    assert!(refused(both).contains("start_from"));
}

/// The bytes of all files below `folder`.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            all.extend(files(&entry));
        } else {
            all.insert(entry.clone(), std::fs::read(&entry).unwrap());
        }
    }
    all
}

/// A checkpoint knows its training: `--resume` refuses another and names the difference; a new training refuses a
/// folder with results. Neither changes a file.
#[test]
fn a_training_in_another_s_folder_destroys_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path();
    let gait = "sandgait/HexapodGait-v1";
    request(gait, out, 256, &json!({})).run(&Silent).unwrap();
    let before = files(out);
    let refused = |request: TrainingRequest| {
        let error = request.run(&Silent).err().expect("it is refused").to_string();
        assert!(files(out) == before, "{error}");
        assert!(!error.contains('\n'), "{error}");
        error
    };
    let resumed = |request: TrainingRequest| refused(TrainingRequest { resume: true, ..request });
    let slope = json!({"max_episode_steps": 30, "slope_deg": 3.0});
    for (request, words) in [
        (TrainingRequest { seed: 4, ..request(gait, out, 512, &json!({})) }, "its seed is 3, not 4"),
        (
            request("sandgait/HexapodLegs-v1", out, 512, &json!({})),
            "its task is sandgait/HexapodGait-v1, not sandgait/",
        ),
        (request(gait, out, 512, &json!({"n_envs": 32})), "its n_envs is 16, not 32"),
        (request(gait, out, 512, &json!({"gamma": 0.9})), "its gamma is 0.99, not 0.9"),
        (TrainingRequest { options: slope, ..request(gait, out, 512, &json!({})) }, "its slope_deg is 0.0, not 3.0"),
    ] {
        let error = resumed(request);
        assert!(
            error.contains("256.safetensors: it belongs to another training: ") && error.contains(words),
            "{error}"
        );
    }
    let error = refused(request(gait, out, 256, &json!({})));
    assert!(error.contains("it has the results of another training: go on with that one with --resume"), "{error}");
    // Only the end of the training differs.
    let more = TrainingRequest { resume: true, ..request(gait, out, 512, &json!({})) };
    assert_eq!(more.run(&Silent).unwrap().learnt.steps, 512);
}

/// A power cut can leave an empty or a torn file. The newest whole checkpoint is used, and a torn end of the curve is
/// left out.
#[test]
fn torn_files_do_not_stop_a_resumption() {
    let directory = tempfile::tempdir().unwrap();
    let [whole, torn] = ["whole", "torn"].map(|name| directory.path().join(name));
    let of = |out: &Path, steps: u64, resume: bool| TrainingRequest {
        resume,
        ..request("sandgait/HexapodGait-v1", out, steps, &json!({"learning_rate": 1e-3}))
    };
    of(&whole, 512, false).run(&Silent).unwrap();
    of(&torn, 256, false).run(&Silent).unwrap();
    let checkpoints = torn.join("checkpoints");
    let good = std::fs::read(checkpoints.join("256.safetensors")).unwrap();
    std::fs::write(checkpoints.join("384.safetensors"), &good[..good.len() / 2]).unwrap();
    std::fs::write(checkpoints.join("512.safetensors"), b"").unwrap();
    std::fs::write(checkpoints.join("640.safetensors"), vec![0; good.len()]).unwrap();
    let curve = torn.join("curve.csv");
    let lines = std::fs::read_to_string(&curve).unwrap();
    std::fs::write(&curve, lines + "384,0.").unwrap();
    let outcome = of(&torn, 512, true).run(&Silent).unwrap();
    assert_eq!(outcome.notices.len(), 3, "{:?}", outcome.notices);
    for (notice, name) in outcome.notices.iter().zip(["640", "512", "384"]) {
        assert!(notice.contains("a checkpoint was skipped: ") && notice.contains(name), "{notice}");
    }
    assert!(result(&whole) == result(&torn));
}

/// A training of LeggedVelocity is scored by commands, and `sandgait evaluate --commands` gives the same table.
#[test]
fn a_legged_training_is_scored_by_commands() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("cat");
    let path = out.to_str().unwrap();
    let task = ["--task", "LeggedVelocity", "--option", "ground=rigid", "--set", "mirror=true"];
    let output = train(&[&SMALL[..10], &task, &["--timesteps", "512", "--out", path]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = |text: &str| text.lines().filter(|line| line.contains(" %")).map(str::to_owned).collect::<Vec<_>>();
    let text = std::fs::read_to_string(out.join("evaluation.txt")).unwrap();
    assert!(text.contains("without noise and randomness, by command:"), "{text}");
    assert!(text.contains("The training ended at level 0.00 of 1 of its curriculum"), "{text}");
    let about: Value = serde_json::from_slice(&std::fs::read(out.join("policy.json")).unwrap()).unwrap();
    assert_eq!(
        (about["rate"].as_f64(), about["observation"][9]["name"].as_str()),
        (Some(50.0), Some("commanded lin_vel_x"))
    );
    let golden = std::fs::read_to_string(out.join("golden.csv")).unwrap();
    assert!(golden.starts_with("t,command_x,") && golden.lines().count() > 20);
    let targets = about["targets"].as_array().unwrap();
    assert_eq!((targets.len(), about["action"].as_array().unwrap().len()), (12, 12));
    assert!(
        targets
            .iter()
            .all(|t| (0.4..=0.5).contains(&t["scale"].as_f64().unwrap()) && t["stiffness"].as_f64() > Some(0.0))
    );
    assert!(std::fs::read_to_string(out.join("curve.csv")).unwrap().starts_with("steps,seconds,return,level\n"));
    let settings: Value = serde_json::from_slice(&std::fs::read(out.join("settings.json")).unwrap()).unwrap();
    assert_eq!(settings["score"]["lines"].as_array().unwrap().len(), 9);
    let csv = directory.path().join("commands.csv");
    let evaluated = Command::new(env!("CARGO_BIN_EXE_sandgait"))
        .args(["evaluate", out.join("policy.onnx").to_str().unwrap(), "--commands", "--csv", csv.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(evaluated.status.success(), "{}", String::from_utf8_lossy(&evaluated.stderr));
    let lines = table(&String::from_utf8(evaluated.stdout).unwrap());
    assert!(table(&text).windows(lines.len()).any(|part| part == lines), "{text}");
    assert_eq!(lines.len(), 10, "nine commands and their mean");
    assert_eq!(std::fs::read_to_string(csv).unwrap().lines().count(), 10);
}

/// Two trainings cannot write into one folder.
#[test]
fn a_second_process_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("out");
    let path = out.to_str().unwrap();
    let steps = ["--timesteps", "100000000", "--out", path];
    let mut first = Command::new(env!("CARGO_BIN_EXE_sandgait"))
        .arg("train")
        .args(SMALL.iter().chain(&steps))
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while !out.join("curve.csv").exists() {
        assert!(first.try_wait().unwrap().is_none(), "the training has ended");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    for more in [&[] as &[&str], &["--resume"]] {
        let line = one_line(&[&SMALL[..], &steps, more].concat());
        assert!(line.contains("another process writes into this folder; choose another one with --out"), "{line}");
    }
    // The lock ends with the process, even if it is killed.
    first.kill().unwrap();
    first.wait().unwrap();
    let output = train(&[&SMALL[..], &["--timesteps", "256", "--out", path]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Settings of small trainings for the command line.
const SMALL: [&str; 14] = [
    "--set",
    "n_envs=16",
    "--set",
    "n_steps=8",
    "--set",
    "batch_size=64",
    "--set",
    "n_epochs=2",
    "--set",
    "policy_kwargs={net_arch: [16]}",
    "--option",
    "max_episode_steps=30",
    "--checkpoint-every",
    "100000000",
];
