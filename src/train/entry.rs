//! Entries of hyperparameter files, one for each task.

use super::settings::{Hyperparameters, MOST_SAMPLES, SECONDS, float};
use super::yaml;
use crate::env::registry::{TASK_IDS, no_task};
use crate::error::{Error, Result, check_range};
use serde_json::{Map, Value, json};
use std::path::Path;

/// The settings of `sandgait train` without a file.
const OWN: &str = include_str!("ppo_fast.yml");
/// Their name in messages.
const BUILT_IN: &str = "built-in settings";

/// The limits of a training, as changes of settings. If only a number of steps is given, the time has no limit.
///
/// # Errors
/// The time is out of range. It is checked here because JSON has no infinite number.
pub fn ends(timesteps: Option<u64>, seconds: Option<f64>) -> Result<Vec<(String, Value)>> {
    let seconds = seconds.map(|s| check_range("seconds", s, SECONDS)).transpose()?;
    let steps = timesteps.map(|steps| ("n_timesteps", json!(steps)));
    let time = match (timesteps, seconds) {
        (_, Some(seconds)) => Some(json!(seconds)),
        (Some(_), None) => Some(Value::Null),
        (None, None) => None,
    };
    let time = time.map(|time| ("seconds", time));
    Ok(steps.into_iter().chain(time).map(|(name, value)| (name.to_owned(), value)).collect())
}

/// The entry of `task` in `file`, or in the program's own file, with `changes`.
pub fn settings(file: Option<&Path>, task: &str, changes: Vec<(String, Value)>) -> Result<Hyperparameters> {
    let mut entry = entry(file, task)?;
    change(&mut entry, changes);
    Hyperparameters::from_entry(&entry)
}

/// Samples of a rollout, and number of its minibatches: the values of PPO's paper for MuJoCo (Schulman et al. 2017,
/// arXiv:1707.06347, table 3) and of CleanRL. The least number of steps in a rollout and of samples in a minibatch are
/// our choice, so that advantages look ahead even with many environments, and gradients of small rollouts are not
/// noisy.
const SAMPLES: usize = 2048;
const MINIBATCHES: usize = 32;
const LEAST_STEPS: usize = 16;
const LEAST_BATCH: usize = 64;

/// Settings for `envs` environments of another program, with `changes`: the entry `name` of `file`, or else the
/// settings of stable-baselines3 with normalization and, as in CleanRL, a falling learning rate. If `changes` limit
/// only the time, the number of steps has no limit.
pub fn external(
    file: Option<&Path>,
    name: &str,
    envs: usize,
    changes: Vec<(String, Value)>,
) -> Result<Hyperparameters> {
    let mut entry = match file {
        Some(_) => entry(file, name)?,
        None => Map::from_iter([("normalize".into(), json!(true)), ("learning_rate".into(), json!("lin_3e-4"))]),
    };
    entry.insert("n_envs".into(), json!(envs));
    if changes.iter().any(|(name, value)| name == "seconds" && !value.is_null()) {
        entry.insert("n_timesteps".into(), json!(1e12));
    }
    change(&mut entry, changes);
    if float(&entry["n_envs"]) != Some(envs as f64) {
        return Err(Error::invalid("n_envs", format!("{} is not the environment's num_envs, {envs}", entry["n_envs"])));
    }
    if file.is_none() {
        let steps = entry.entry("n_steps").or_insert_with(|| json!((SAMPLES / envs.max(1)).max(LEAST_STEPS)));
        let samples = envs.saturating_mul(float(steps).map_or(1, |steps| steps as usize));
        let batch = (samples / MINIBATCHES).max(LEAST_BATCH).min(samples).min(MOST_SAMPLES);
        entry.entry("batch_size").or_insert_with(|| json!(batch));
    }
    Hyperparameters::from_entry(&entry)
}

/// Replaces values of `entry`. In a dictionary only the given keys change. A time that is given holds for all robots.
fn change(entry: &mut Map<String, Value>, changes: Vec<(String, Value)>) {
    if changes.iter().any(|(name, _)| name == "seconds") {
        entry.remove("biped_seconds");
    }
    for (name, value) in changes {
        match (entry.get_mut(&name), value) {
            (Some(Value::Object(old)), Value::Object(new)) => old.extend(new),
            (_, value) => drop(entry.insert(name, value)),
        }
    }
}

fn entry(file: Option<&Path>, task: &str) -> Result<Map<String, Value>> {
    let (name, text) = match file {
        Some(path) => (path.display().to_string(), crate::files::read_text(path)?),
        None => (BUILT_IN.to_owned(), OWN.to_owned()),
    };
    let all = yaml::read(&text).map_err(|e| Error::File { path: name.clone(), reason: e.to_string() })?;
    let Value::Object(mut all) = all else {
        return Err(Error::File { path: name, reason: "it is no table of tasks".into() });
    };
    match all.remove(task) {
        Some(Value::Object(entry)) => Ok(entry),
        Some(_) => Err(Error::File { path: name, reason: format!("{task}: no table of settings") }),
        None => {
            let known: Vec<_> = all.keys().map(String::as_str).collect();
            if file.is_none() && !TASK_IDS.contains(&task) {
                return Err(no_task(task));
            }
            let reason = format!("there are no settings for {task:?}, only for {}", known.join(", "));
            Err(Error::File { path: name, reason })
        }
    }
}

/// Splits NAME=YAML.
pub fn pair(option: &str, text: &str) -> Result<(String, Value)> {
    let (name, value) =
        text.split_once('=').ok_or_else(|| Error::invalid(option, format!("{text:?} is not NAME=VALUE")))?;
    let value = yaml::read(value).map_err(|e| Error::invalid(format!("{option} {name}"), e.to_string()))?;
    Ok((name.to_owned(), value))
}

/// The same for several of them.
///
/// # Errors
/// One is no NAME=YAML, or a name is given twice.
pub fn pairs(option: &str, texts: &[String]) -> Result<Vec<(String, Value)>> {
    let mut all: Vec<(String, Value)> = Vec::with_capacity(texts.len());
    for text in texts {
        let (name, value) = pair(option, text)?;
        if all.iter().any(|(other, _)| *other == name) {
            return Err(Error::invalid(format!("{option} {name}"), "is given twice"));
        }
        all.push((name, value));
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::registry::task_id;

    #[test]
    fn own_settings_are_sound() {
        let all = yaml::read(OWN).unwrap();
        for task in all.as_object().unwrap().keys() {
            settings(None, task, Vec::new()).unwrap();
        }
        let python = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/hyperparameters/ppo.yml");
        for task in ["HexapodGait", "HexapodLegs", "HexapodTerrain", "HexapodRocks"] {
            let read = settings(Some(&python), task_id(task), Vec::new()).unwrap();
            assert_eq!((read.gamma, read.learning_rate.falls, read.mirror), (0.95, true, Some(true)));
            // The settings can be read back from settings.json.
            assert_eq!(Hyperparameters::from_entry(read.json().as_object().unwrap()).unwrap(), read);
        }
    }

    #[test]
    fn settings_of_other_environments_suit_their_number() {
        let of = |envs, changes: &[&str]| {
            external(None, "Pendulum-v1", envs, changes.iter().map(|c| pair("--set", c).unwrap()).collect())
        };
        for (envs, steps, batch) in [(1, 2048, 64), (16, 128, 64), (1000, 16, 500)] {
            let settings = of(envs, &[]).unwrap();
            assert_eq!((settings.n_envs, settings.n_steps, settings.batch_size), (envs, steps, batch));
            assert!(settings.normalize && settings.n_timesteps == 1_000_000);
        }
        assert_eq!(of(3, &["n_steps=4", "n_envs=3.0"]).unwrap().batch_size, 12);
        assert_eq!(of(3, &["seconds=5"]).unwrap().n_timesteps, 1_000_000_000_000);
        assert_eq!(of(3, &["seconds=5", "n_timesteps=7"]).unwrap().n_timesteps, 7);
        for (change, says) in [
            ("n_envs=4", "n_envs: 4 is not the environment's num_envs, 3"),
            ("n_steps=high", "n_steps: \"high\" is no number"),
            ("n_steps=1e300", "n_steps: "),
        ] {
            let error = of(3, &[change]).unwrap_err().to_string();
            assert!(error.starts_with(says), "{error}");
        }
    }

    #[test]
    fn wrong_settings_are_refused_in_a_line() {
        let id = task_id("HexapodGait");
        for (change, says) in [
            ("gama=0.9", "setting \"gama\" is unknown; did you mean \"gamma\"? known: n_envs"),
            ("gamma", "--set: \"gamma\" is not NAME=VALUE"),
            ("gamma=2", "gamma: 2 is outside [0, 1]"),
            ("gamma=high", "gamma: \"high\" is no number"),
            ("learning_rate=lin_x", "learning_rate: \"lin_x\" is neither a number nor lin_NUMBER"),
            ("n_epochs=2.5", "n_epochs: 2.5 is not whole"),
            ("batch_size=1_000_000", "batch_size: 1000000 is more than n_envs · n_steps = 4096"),
            ("n_steps=4_000_000", "n_envs · n_steps: 1024000000 is outside"),
            ("policy=CnnPolicy", "policy: \"CnnPolicy\" is not MlpPolicy"),
            ("policy_kwargs={net_arch: [64, 0]}", "policy_kwargs.net_arch: 0 is outside [1, 1024]"),
            ("policy_kwargs={squash_output: true}", "setting of policy_kwargs \"squash_output\" is unknown"),
            ("gamma=[", "--set gamma: YAML: "),
        ] {
            let error = pair("--set", change).and_then(|change| settings(None, id, vec![change]));
            let error = error.unwrap_err().to_string();
            assert!(error.starts_with(says) && !error.contains('\n'), "{error}");
        }
        let twice = ["gamma=0.9", "seed=1", "gamma=0.8"].map(str::to_owned);
        assert_eq!(pairs("--set", &twice).unwrap_err().to_string(), "--set gamma: is given twice");
        assert_eq!(pairs("--set", &twice[..2]).unwrap().len(), 2);
        let kept = settings(None, id, vec![pair("--set", "policy_kwargs={log_std_init: -1}").unwrap()]).unwrap();
        assert_eq!((kept.log_std_init, &kept.net_arch[0]), (-1.0, &vec![64, 64]));
        let error = settings(None, "None", Vec::new()).unwrap_err().to_string();
        assert!(error.starts_with("task \"None\" is unknown; known: sandgait/HexapodGait-v1, "), "{error}");
        let error = settings(None, task_id("LegStroke"), Vec::new()).unwrap_err().to_string();
        let said = "built-in settings: there are no settings for \"sandgait/LegStroke-v0\", only for ";
        assert!(error.starts_with(said), "{error}");
    }

    /// In JSON a time that is no number would become null, which means no limit.
    #[test]
    fn the_time_is_a_number_in_its_range() {
        for seconds in [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e8] {
            let error = ends(None, Some(seconds)).unwrap_err().to_string();
            assert!(error.starts_with("seconds: ") && error.ends_with("is outside [0.001, 10000000]"), "{error}");
        }
        assert_eq!(
            ends(Some(5), Some(2.5)).unwrap(),
            [("n_timesteps".into(), json!(5)), ("seconds".into(), json!(2.5))]
        );
    }
}
