//! Checkpoints: files from which a training can go on, here or with stable-baselines3 (`sandgait.export.to_sb3`).

use super::adam::Adam;
use super::curve::OpenPoint;
use super::network::NetworkLayer;
use super::normal::{Normalizer, RunningStatistics};
use super::plan::{TrainingPlan, TrainingState};
use super::saved_environments::{Episodes, SavedEnvironments};
use super::settings::Hyperparameters;
use super::tensors::{self, Tensors};
use crate::error::{Error, Result};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The files' `format`; a reader refuses any other.
const FORMAT: &str = "sandgait policy 1";
/// Ending of the files' names.
const ENDING: &str = "safetensors";

fn layers(plan: &TrainingPlan) -> impl Iterator<Item = (String, &NetworkLayer)> {
    let shape = &plan.networks.shape;
    let named = |name: &'static str| move |(k, layer)| (format!("{name}.{k}"), layer);
    let actor = shape.actor.iter().enumerate().map(named("actor"));
    actor.chain(shape.critic.iter().enumerate().map(named("critic")))
}

/// The contents of a checkpoint.
pub struct Checkpoint {
    pub learnt: TrainingState,
    pub open: OpenPoint,
    /// One sentence for each way in which this differs from the newest checkpoint.
    pub notices: Vec<String>,
}

/// Saves all of `learnt`, and `open`, the sums for the next point of the curve. Weights are f32 [inputs, outputs]. If the
/// environments would make the file larger than can be read, they are left out; the sentence says so.
pub fn save(path: &Path, plan: &TrainingPlan, learnt: &TrainingState, open: &OpenPoint) -> Result<Option<String>> {
    save_within(path, plan, learnt, open, tensors::MOST)
}

fn save_within(
    path: &Path,
    plan: &TrainingPlan,
    learnt: &TrainingState,
    open: &OpenPoint,
    most: u64,
) -> Result<Option<String>> {
    let mut file = of_learnt(plan, learnt, open);
    let Some(kept) = &learnt.environments else { return file.save(path).map(|()| None) };
    let bytes = kept.episodes.bytes()?;
    let size = file.size_with(bytes.len());
    if size > most {
        let notice = format!(
            "checkpoints have no environments, because they would have {} MiB, more than {}: after --resume new \
             episodes begin",
            size >> 20,
            most >> 20
        );
        return file.save(path).map(|()| Some(notice));
    }
    let place = if matches!(kept.episodes, Episodes::OnServer(_)) { "server" } else { "here" };
    file.about.insert("environments".into(), place.into());
    file.add("environments", &[bytes.len()], &bytes);
    file.add("environments.discounted", &[kept.discounted.len()], &kept.discounted);
    file.add("environments.returns", &[kept.returns.len()], &kept.returns);
    file.save(path).map(|()| None)
}

/// The contents of a checkpoint, except for the environments.
fn of_learnt(plan: &TrainingPlan, learnt: &TrainingState, open: &OpenPoint) -> Tensors {
    let mut file = Tensors::default();
    let about = [
        ("format", FORMAT.to_owned()),
        ("sandgait", env!("CARGO_PKG_VERSION").into()),
        ("task", plan.spec.id.clone()),
        ("settings", plan.settings.json().to_string()),
        ("seed", plan.seed.to_string()),
        ("steps", learnt.steps.to_string()),
        ("updates", learnt.updates.to_string()),
        ("adam_steps", learnt.adam.steps.to_string()),
        // With other options the episodes would differ.
        ("options", json!(plan.spec.options).to_string()),
        ("curve.terms", json!(open.terms.iter().map(|(name, _)| name).collect::<Vec<_>>()).to_string()),
    ];
    file.about.extend(about.map(|(name, text)| (name.to_owned(), text)));
    file.add("seconds", &[], &[learnt.seconds]);
    file.add("curve.open", &[2], &open.episodes);
    let sums: Vec<f64> = [open.updates].into_iter().chain(open.terms.iter().map(|(_, sum)| *sum)).collect();
    file.add("curve.terms", &[sums.len()], &sums);
    if plan.spec.blueprint.is_none() {
        for (name, bound) in [("low", 0), ("high", 1)] {
            let bounds: Vec<f64> = plan.spec.action.iter().map(|column| [column.low, column.high][bound]).collect();
            file.add(format!("action.{name}"), &[bounds.len()], &bounds);
        }
    }
    for (prefix, numbers) in
        [("", &learnt.parameters), ("adam.first.", &learnt.adam.first), ("adam.second.", &learnt.adam.second)]
    {
        for (name, layer) in layers(plan) {
            let [weights, bias] = [&layer.weights, &layer.bias].map(|place| &numbers[place.clone()]);
            file.add(format!("{prefix}{name}.weights"), &[layer.inputs, layer.outputs], weights);
            file.add(format!("{prefix}{name}.bias"), &[layer.outputs], bias);
        }
        let log_std = &numbers[plan.networks.shape.log_std.clone()];
        file.add(format!("{prefix}log_std"), &[log_std.len()], log_std);
    }
    if let Some(Normalizer { observations, returns }) = &learnt.normal {
        for (name, running) in [("observations", observations), ("returns", returns)] {
            file.add(format!("{name}.mean"), &[running.mean.len()], &running.mean);
            file.add(format!("{name}.variance"), &[running.variance.len()], &running.variance);
            file.add(format!("{name}.count"), &[], &[running.count]);
        }
    }
    for (name, mirror) in ["observation", "action"].iter().zip(plan.networks.mirror.iter().flatten()) {
        let order: Vec<i64> = mirror.order.iter().map(|k| *k as i64).collect();
        file.add(format!("mirror.{name}.order"), &[mirror.order.len()], &order);
        file.add(format!("mirror.{name}.signs"), &[mirror.signs.len()], &mirror.signs);
    }
    file
}

/// Reads a file of [`save`] for a plan with the same task, networks and normalization. `away`: the environments are
/// remote.
pub fn load(path: &Path, plan: &TrainingPlan, away: bool) -> Result<Checkpoint> {
    of_file(path, &Tensors::load(path)?, plan, away)
}

fn of_file(path: &Path, file: &Tensors, plan: &TrainingPlan, away: bool) -> Result<Checkpoint> {
    read(file, plan, away).map_err(|e| match e {
        Error::Invalid { reason, .. } => Error::file(path, reason),
        other => other,
    })
}

/// The newest whole checkpoint in the results' folder `out`, which must belong to the training of `plan`. Checkpoints that
/// are empty or cut off are skipped with a notice.
pub fn newest(out: &Path, plan: &TrainingPlan, away: bool) -> Result<Checkpoint> {
    let mut broken = Vec::new();
    for path in all(out) {
        match Tensors::load(&path) {
            Ok(file) => {
                belongs(&file, plan).map_err(|why| {
                    Error::file(
                        &path,
                        format!(
                            "it belongs to another training: {why}; a training can begin from it with --start-from"
                        ),
                    )
                })?;
                let mut saved = of_file(&path, &file, plan, away)?;
                saved.notices.extend(broken.iter().map(|e: &Error| format!("a checkpoint was skipped: {e}")));
                return Ok(saved);
            }
            Err(error) => broken.push(error),
        }
    }
    Err(broken.into_iter().next().unwrap_or_else(|| Error::file(&folder(out), "there is no checkpoint to go on from")))
}

/// Does `out` contain the results of a training?
pub fn is_used(out: &Path) -> bool {
    !all(out).is_empty() || ["policy.onnx", "policy.safetensors"].iter().any(|name| out.join(name).exists())
}

/// If the checkpoint is not of the training of `plan`, the error says what differs. The limits of steps and time may
/// differ.
fn belongs(file: &Tensors, plan: &TrainingPlan) -> std::result::Result<(), String> {
    let text = |name: &str| file.text(name).map_err(|e| e.to_string());
    let seed = plan.seed.to_string();
    for (name, there, here) in [("task", text("task")?, &plan.spec.id), ("seed", text("seed")?, &seed)] {
        if there != here {
            return Err(format!("its {name} is {there}, not {here}"));
        }
    }
    let table = |name: &str| -> std::result::Result<Map<String, Value>, String> {
        serde_json::from_str(text(name)?).map_err(|e| format!("its {name} cannot be read: {e}"))
    };
    let there = Hyperparameters::from_entry(&table("settings")?).map_err(|e| e.to_string())?;
    let ends = |settings: Hyperparameters| {
        Hyperparameters { n_timesteps: 1, seconds: None, biped_seconds: None, env_kwargs: Map::new(), ..settings }
            .json()
    };
    let (there, here) = (ends(there), ends(plan.settings.clone()));
    differs(there.as_object(), here.as_object()).map_or(Ok(()), Err)?;
    differs(Some(&table("options")?), Some(&plan.spec.options)).map_or(Ok(()), Err)
}

/// The first value of `there` that is missing or different in `here`. A name that only `here` has comes from a newer
/// version, and is no difference.
fn differs(there: Option<&Map<String, Value>>, here: Option<&Map<String, Value>>) -> Option<String> {
    let short = |value: &Value| {
        let text = value.to_string();
        // A packed robot is long.
        text.char_indices().nth(60).map_or(text.clone(), |(end, _)| format!("{} …", &text[..end]))
    };
    let here = here?;
    let (name, value) = there?.iter().find(|(name, value)| here.get(*name) != Some(value))?;
    Some(format!("its {name} is {}, not {}", short(value), here.get(name).map_or("known".into(), short)))
}

/// The environments of `file`, or the reason why they cannot be used.
fn environments(
    file: &Tensors,
    plan: &TrainingPlan,
    away: bool,
) -> Result<std::result::Result<SavedEnvironments, String>> {
    let unfit = match file.text("environments").ok() {
        None if plan.spec.blueprint.is_none() => format!("{} cannot be saved", plan.spec.id),
        None => "the checkpoint has no environments".to_owned(),
        Some(place) if (place == "server") != away => {
            let place = if away { "this process" } else { "a server" };
            format!("the checkpoint's environments are of {place}")
        }
        Some(_) if file.text("sandgait")? != env!("CARGO_PKG_VERSION") => {
            format!("the checkpoint is of sandgait {}", file.text("sandgait")?)
        }
        Some(_) => {
            let count = |name: &str| file.get(name, plan.settings.n_envs);
            let (discounted, returns) = (count("environments.discounted")?, count("environments.returns")?);
            let episodes = Episodes::read(file.all("environments")?, away)?;
            return Ok(Ok(SavedEnvironments { episodes, discounted, returns }));
        }
    };
    Ok(Err(unfit))
}

fn read(file: &Tensors, plan: &TrainingPlan, away: bool) -> Result<Checkpoint> {
    let wrong = |why: String| Error::invalid("checkpoint", why);
    if file.text("format")? != FORMAT {
        return Err(wrong(format!("it is {:?}, not {FORMAT:?}", file.text("format")?)));
    }
    let (task, wanted) = (file.text("task")?, &plan.spec.id);
    if task != wanted {
        return Err(wrong(format!("it was learnt for {task}, not for {wanted}")));
    }
    let whole = |name: &str| {
        let text = file.text(name)?;
        text.parse::<u64>().map_err(|_| wrong(format!("its {name} {text:?} is no number")))
    };
    let all = |prefix: &str| {
        let mut numbers = vec![0.0; plan.networks.shape.parameters];
        for (name, layer) in layers(plan) {
            let weights = file.get(&format!("{prefix}{name}.weights"), layer.weights.len())?;
            numbers[layer.weights.clone()].copy_from_slice(&weights);
            numbers[layer.bias.clone()].copy_from_slice(&file.get(&format!("{prefix}{name}.bias"), layer.bias.len())?);
        }
        let log_std = plan.networks.shape.log_std.clone();
        numbers[log_std.clone()].copy_from_slice(&file.get(&format!("{prefix}log_std"), log_std.len())?);
        Ok(numbers)
    };
    let running = |name: &str, width: usize| {
        let mean = file.get(&format!("{name}.mean"), width)?;
        let variance = file.get(&format!("{name}.variance"), width)?;
        Ok(RunningStatistics { mean, variance, count: file.get(&format!("{name}.count"), 1)?[0] })
    };
    let normalized = file.has("observations.mean");
    if normalized != plan.settings.normalize || file.has("mirror.action.order") != plan.networks.mirror.is_some() {
        return Err(wrong("it was learnt with other settings of normalize or mirror".into()));
    }
    let normal = || {
        let observations = running("observations", plan.networks.shape.observation)?;
        Ok(Normalizer { observations, returns: running("returns", 1)? })
    };
    let adam = Adam { first: all("adam.first.")?, second: all("adam.second.")?, steps: whole("adam_steps")? };
    let environments = environments(file, plan, away)?;
    let learnt = TrainingState {
        parameters: all("")?,
        adam,
        normal: normalized.then(normal).transpose()?,
        steps: whole("steps")?,
        updates: whole("updates")?,
        seconds: file.get("seconds", 1)?[0],
        environments: environments.as_ref().ok().cloned().map(Arc::new),
    };
    let notices = environments.err().map(|why| format!("new episodes began at the resumption: {why}"));
    Ok(Checkpoint { learnt, open: open(file), notices: notices.into_iter().collect() })
}

/// The sums for the next point of the curve; files of earlier versions have no reward terms.
fn open(file: &Tensors) -> OpenPoint {
    let names: Vec<String> =
        file.text("curve.terms").ok().and_then(|t| serde_json::from_str(t).ok()).unwrap_or_default();
    let sums: Vec<f64> = file.get("curve.terms", names.len() + 1).unwrap_or_default();
    OpenPoint {
        episodes: file.get("curve.open", 2).map_or([0.0; 2], |open| [open[0], open[1]]),
        updates: sums.first().copied().unwrap_or(0.0),
        terms: names.into_iter().zip(sums.into_iter().skip(1)).collect(),
    }
}

/// The file of a checkpoint in the results' folder `out`.
pub fn path(out: &Path, steps: u64) -> PathBuf {
    folder(out).join(format!("{steps}.{ENDING}"))
}

pub fn folder(out: &Path) -> PathBuf {
    out.join("checkpoints")
}

/// The checkpoints in the results' folder `out`, newest first.
fn all(out: &Path) -> Vec<PathBuf> {
    let steps = |path: PathBuf| -> Option<(u64, PathBuf)> {
        let name = path.file_name()?.to_str()?.strip_suffix(ENDING)?.strip_suffix('.')?;
        Some((name.parse().ok()?, path))
    };
    let entries = std::fs::read_dir(folder(out)).into_iter().flatten().flatten();
    let mut all: Vec<_> = entries.filter_map(|entry| steps(entry.path())).collect();
    all.sort_unstable_by(|a, b| b.cmp(a));
    all.into_iter().map(|(_, path)| path).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is written can be read: environments that are too large for a file are left out, with a notice.
    #[test]
    fn a_checkpoint_is_never_larger_than_can_be_read() {
        let plan = crate::plan::tests::plan(&json!({"n_envs": 4, "n_steps": 2, "batch_size": 8}), 1);
        let kept = |size| SavedEnvironments {
            episodes: Episodes::OnServer(vec![7; size]),
            discounted: vec![0.0; 4],
            returns: vec![0.0; 4],
        };
        let learnt = |size| TrainingState { environments: Some(Arc::new(kept(size))), ..plan.begin() };
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("8.safetensors");
        let most = 8 << 20;
        for (size, fits) in [(1 << 20, true), (5 << 20, false)] {
            let notice = save_within(&path, &plan, &learnt(size), &OpenPoint::default(), most).unwrap();
            assert_eq!(notice.is_none(), fits, "{notice:?}");
            assert!(std::fs::metadata(&path).unwrap().len() <= most);
            let read = load(&path, &plan, true).unwrap();
            assert_eq!(read.learnt.environments.is_some(), fits);
            assert_eq!(read.notices.is_empty(), fits, "{:?}", read.notices);
        }
    }
}
