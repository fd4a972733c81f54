//! Checkpoints: files from which a training can go on, here or with stable-baselines3 (`sandgait.export.to_sb3`).

use super::adam::Adam;
use super::kept::{Episodes, Kept};
use super::network::Layer;
use super::normal::{Normal, Running};
use super::plan::{Learnt, Plan};
use super::tensors::{Numbers, Tensors};
use crate::error::{Error, Result};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The files' `format`; a reader refuses any other.
const FORMAT: &str = "sandgait policy 1";
/// Ending of the files' names.
const ENDING: &str = "safetensors";

fn layers(plan: &Plan) -> impl Iterator<Item = (String, &Layer)> {
    let shape = &plan.networks.shape;
    let named = |name: &'static str| move |(k, layer)| (format!("{name}.{k}"), layer);
    let actor = shape.actor.iter().enumerate().map(named("actor"));
    actor.chain(shape.critic.iter().enumerate().map(named("critic")))
}

/// The task options of the training. With other options the episodes would be different ones.
fn options(plan: &Plan) -> String {
    json!(plan.blueprint.task.options()).to_string()
}

/// The contents of a checkpoint.
pub struct Saved {
    pub learnt: Learnt,
    /// See [`super::curve::Curve::open`].
    pub open: [f64; 2],
    /// The reason why new episodes begin, if they do.
    pub anew: Option<String>,
}

/// Saves all of `learnt`, and the curve's `open` episodes. Weights are f32 [inputs, outputs].
pub fn save(path: &Path, plan: &Plan, learnt: &Learnt, open: [f64; 2]) -> Result<()> {
    let mut file = Tensors::default();
    let about = [
        ("format", FORMAT.to_owned()),
        ("sandgait", env!("CARGO_PKG_VERSION").into()),
        ("task", plan.blueprint.task.spec().id.into()),
        ("settings", plan.settings.json().to_string()),
        ("seed", plan.seed.to_string()),
        ("steps", learnt.steps.to_string()),
        ("updates", learnt.updates.to_string()),
        ("adam_steps", learnt.adam.steps.to_string()),
        ("options", options(plan)),
    ];
    file.about.extend(about.map(|(name, text)| (name.to_owned(), text.into())));
    file.add("seconds", &[], Numbers::F64(vec![learnt.seconds]));
    file.add("curve.open", &[2], Numbers::F64(open.to_vec()));
    for (prefix, numbers) in
        [("", &learnt.parameters), ("adam.first.", &learnt.adam.first), ("adam.second.", &learnt.adam.second)]
    {
        for (name, layer) in layers(plan) {
            let weights = Numbers::F32(numbers[layer.weights.clone()].to_vec());
            file.add(format!("{prefix}{name}.weights"), &[layer.inputs, layer.outputs], weights);
            let bias = Numbers::F32(numbers[layer.bias.clone()].to_vec());
            file.add(format!("{prefix}{name}.bias"), &[layer.outputs], bias);
        }
        let log_std = &numbers[plan.networks.shape.log_std.clone()];
        file.add(format!("{prefix}log_std"), &[log_std.len()], Numbers::F32(log_std.to_vec()));
    }
    if let Some(Normal { observations, returns }) = &learnt.normal {
        for (name, running) in [("observations", observations), ("returns", returns)] {
            file.add(format!("{name}.mean"), &[running.mean.len()], Numbers::F64(running.mean.clone()));
            file.add(format!("{name}.variance"), &[running.variance.len()], Numbers::F64(running.variance.clone()));
            file.add(format!("{name}.count"), &[], Numbers::F64(vec![running.count]));
        }
    }
    for (name, mirror) in ["observation", "action"].iter().zip(plan.networks.mirror.iter().flatten()) {
        let order = mirror.order.iter().map(|k| *k as i64).collect();
        file.add(format!("mirror.{name}.order"), &[mirror.order.len()], Numbers::I64(order));
        file.add(format!("mirror.{name}.signs"), &[mirror.signs.len()], Numbers::F32(mirror.signs.clone()));
    }
    if let Some(kept) = &learnt.environments {
        let bytes = kept.episodes.bytes()?;
        let place = if matches!(kept.episodes, Episodes::Away(_)) { "server" } else { "here" };
        file.about.insert("environments".into(), place.into());
        file.add("environments", &[bytes.len()], Numbers::U8(bytes));
        file.add("environments.discounted", &[kept.discounted.len()], Numbers::F64(kept.discounted.clone()));
        file.add("environments.returns", &[kept.returns.len()], Numbers::F64(kept.returns.clone()));
    }
    file.save(path)
}

/// Reads a file of [`save`] for a plan with the same task, networks and normalization; `away`: environments are on
/// a server.
pub fn load(path: &Path, plan: &Plan, away: bool) -> Result<Saved> {
    let file = Tensors::load(path)?;
    read(&file, plan, away).map_err(|e| match e {
        Error::Invalid { reason, .. } => Error::file(path, reason),
        other => other,
    })
}

/// The environments, or the reason why those of `file` cannot be used.
fn environments(file: &Tensors, plan: &Plan, away: bool) -> Result<std::result::Result<Kept, String>> {
    let envs = plan.settings.n_envs;
    let count = |name: &str| file.f64(name, envs);
    let unfit = match file.text("environments").ok() {
        None => "the checkpoint has no environments".to_owned(),
        Some(place) if (place == "server") != away => format!(
            "the checkpoint's environments are of {}",
            match away {
                true => "this process",
                false => "a server",
            }
        ),
        Some(_) if file.text("sandgait")? != env!("CARGO_PKG_VERSION") => {
            format!("the checkpoint is of sandgait {}", file.text("sandgait")?)
        }
        Some(_) if file.text("options")? != options(plan) => "the checkpoint's task has other options".into(),
        Some(_) if count("environments.returns").is_err() => format!("the checkpoint has not {envs} environments"),
        Some(_) => {
            let (discounted, returns) = (count("environments.discounted")?, count("environments.returns")?);
            let episodes = Episodes::read(file.bytes("environments")?, away)?;
            return Ok(Ok(Kept { episodes, discounted, returns }));
        }
    };
    Ok(Err(unfit))
}

fn read(file: &Tensors, plan: &Plan, away: bool) -> Result<Saved> {
    let wrong = |why: String| Error::invalid("checkpoint", why);
    if file.text("format")? != FORMAT {
        return Err(wrong(format!("it is {:?}, not {FORMAT:?}", file.text("format")?)));
    }
    let (task, wanted) = (file.text("task")?, plan.blueprint.task.spec().id);
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
            let weights = file.f32(&format!("{prefix}{name}.weights"), layer.weights.len())?;
            numbers[layer.weights.clone()].copy_from_slice(&weights);
            numbers[layer.bias.clone()].copy_from_slice(&file.f32(&format!("{prefix}{name}.bias"), layer.bias.len())?);
        }
        let log_std = plan.networks.shape.log_std.clone();
        numbers[log_std.clone()].copy_from_slice(&file.f32(&format!("{prefix}log_std"), log_std.len())?);
        Ok(numbers)
    };
    let running = |name: &str, width: usize| {
        let mean = file.f64(&format!("{name}.mean"), width)?;
        let variance = file.f64(&format!("{name}.variance"), width)?;
        Ok(Running { mean, variance, count: file.f64(&format!("{name}.count"), 1)?[0] })
    };
    let normalized = file.has("observations.mean");
    if normalized != plan.settings.normalize || file.has("mirror.action.order") != plan.settings.mirror {
        return Err(wrong("it was learnt with other settings of normalize or mirror".into()));
    }
    let normal = || {
        let observations = running("observations", plan.networks.shape.observation)?;
        Ok(Normal { observations, returns: running("returns", 1)? })
    };
    let adam = Adam { first: all("adam.first.")?, second: all("adam.second.")?, steps: whole("adam_steps")? };
    let environments = environments(file, plan, away)?;
    let learnt = Learnt {
        parameters: all("")?,
        adam,
        normal: normalized.then(normal).transpose()?,
        steps: whole("steps")?,
        updates: whole("updates")?,
        seconds: file.f64("seconds", 1)?[0],
        environments: environments.as_ref().ok().cloned().map(Arc::new),
    };
    let open = file.f64("curve.open", 2).map_or([0.0; 2], |open| [open[0], open[1]]);
    Ok(Saved { learnt, open, anew: environments.err() })
}

/// The file of a checkpoint in the results' folder `out`.
pub fn path(out: &Path, steps: u64) -> PathBuf {
    folder(out).join(format!("{steps}.{ENDING}"))
}

pub fn folder(out: &Path) -> PathBuf {
    out.join("checkpoints")
}

/// The newest checkpoint in the results' folder `out`.
pub fn last(out: &Path) -> Result<PathBuf> {
    let folder = folder(out);
    let steps = |path: &PathBuf| -> Option<u64> {
        let name = path.file_name()?.to_str()?.strip_suffix(ENDING)?.strip_suffix('.')?;
        name.parse().ok()
    };
    let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let newest = entries.filter(|path| steps(path).is_some()).max_by_key(|path| steps(path));
    newest.ok_or_else(|| Error::file(&folder, "there is no checkpoint to go on from"))
}
