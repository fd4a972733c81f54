//! Which tasks there are, and how a session's environments are made from an id and options.

use super::gait::HexapodGait;
use super::legged::{self, LeggedVelocity};
use super::legs::HexapodLegs;
use super::options::keywords::{self, Keywords};
use super::options::{Control, OPTION_HELP, Randomize, ResetOptions, RockOptions, StrokeOptions, TaskOptions};
use super::rocks::HexapodRocks;
use super::stroke::{self, LegStroke};
use super::task::{Setup, Task};
use super::terrain::HexapodTerrain;
use crate::error::{Error, Result};
use crate::sim::Model;
use crate::sim::engine::EngineKind;
use serde_json::Value;
use std::sync::Arc;

/// A task with its options: everything a session is made from.
#[derive(Clone)]
pub struct Blueprint {
    pub task: Arc<dyn Task>,
    pub engine: EngineKind,
    pub setup: Setup,
}

/// States, options and bookkeeping of an episode [bytes], and its share of the messages in flight; measured.
const EPISODE_BYTES: usize = 2_000;

/// A model of its own and the longest memory of footprints [bytes]; counted.
const GROUND_BYTES: usize = 24_000;

/// A task before it has options.
struct Kind {
    keywords: &'static Keywords,
    defaults: fn() -> TaskOptions,
    make: fn(&Setup) -> Result<Arc<dyn Task>>,
}

const KINDS: [Kind; Keywords::ALL.len()] = [
    Kind {
        keywords: &keywords::GAIT,
        defaults: || TaskOptions { control: Some(Control::HipSpeed), ..Default::default() },
        make: |setup| Ok(Arc::new(HexapodGait::new(setup)?)),
    },
    Kind {
        keywords: &keywords::LEGS,
        defaults: || TaskOptions { robot: "xplorer18".into(), leg: "flat".into(), ..Default::default() },
        make: |setup| Ok(Arc::new(HexapodLegs::new(setup)?)),
    },
    Kind {
        keywords: &keywords::ROCKS,
        defaults: || TaskOptions {
            engine: EngineKind::Rapier,
            dt: EngineKind::Rapier.default_dt(),
            control: Some(Control::HipSpeed),
            rocks: Some(RockOptions::default()),
            ..Default::default()
        },
        make: |setup| Ok(Arc::new(HexapodRocks::new(setup)?)),
    },
    Kind {
        keywords: &keywords::TERRAIN,
        defaults: || TaskOptions {
            control: Some(Control::HipSpeed),
            randomize: Some(Randomize::default()),
            difficulty: Some(1.0),
            ..Default::default()
        },
        make: |setup| Ok(Arc::new(HexapodTerrain::new(setup)?)),
    },
    Kind {
        keywords: &keywords::STROKE,
        defaults: || TaskOptions {
            engine: EngineKind::Carriage,
            leg: "flat".into(),
            angle_noise: 0.0,
            dt: stroke::DT,
            max_episode_steps: stroke::STEPS,
            stroke: Some(StrokeOptions::default()),
            ..Default::default()
        },
        make: |setup| Ok(Arc::new(LegStroke::new(setup)?)),
    },
    Kind {
        keywords: &keywords::LEGGED,
        defaults: legged::defaults,
        make: |setup| Ok(Arc::new(LeggedVelocity::new(setup)?)),
    },
];

/// One keyword of a task, for tables.
pub struct Keyword {
    pub name: &'static str,
    pub summary: &'static str,
    /// What it is in this session.
    pub value: Value,
    /// May a reset change it?
    pub at_reset: bool,
}

/// Ids of all tasks.
pub const TASK_IDS: [&str; Keywords::ALL.len()] = {
    let mut ids = [""; Keywords::ALL.len()];
    let mut i = 0;
    while i < ids.len() {
        ids[i] = Keywords::ALL[i].task;
        i += 1;
    }
    ids
};

/// Why there is no task `id`: it is an earlier version of another, or nothing at all.
fn no_task(id: &str) -> Error {
    let version = |id: &str| id.rsplit_once("-v").and_then(|(name, v)| Some((name.to_owned(), v.parse::<u32>().ok()?)));
    let earlier = |new: &&&str| match (version(id), version(new)) {
        (Some((old, v)), Some((name, w))) => old == name && v < w,
        _ => false,
    };
    match TASK_IDS.iter().find(earlier) {
        Some(new) => Error::Replaced { what: "task", name: id.into(), new: (*new).into() },
        None => Error::unknown("task", id, &TASK_IDS),
    }
}

impl Blueprint {
    /// Task `id` with the keywords in `options` (a JSON object; null for defaults).
    pub fn new(id: &str, options: Value) -> Result<Self> {
        let kind = KINDS.iter().find(|k| k.keywords.task == id).ok_or_else(|| no_task(id))?;
        let options = (kind.defaults)().with(options, |name| kind.keywords.check(name))?;
        let engine = options.engine;
        if !EngineKind::ALL.contains(&engine) && kind.keywords.has("engine") {
            return Err(Error::unknown("engine", engine.name(), &EngineKind::ALL.map(EngineKind::name)));
        }
        let setup = Setup::new(kind.keywords, options)?;
        let task = (kind.make)(&setup)?;
        let period = 1.0 / task.spec().control_rate;
        let (dt, steps) = (setup.options.dt, period / setup.options.dt);
        if (steps - steps.round()).abs() > 1e-6 * steps {
            return Err(Error::invalid("dt", format!("{dt} does not divide the control period {period} s")));
        }
        Ok(Self { task, engine, setup })
    }

    /// The same task with another robot or sand than the options can name. Resets with options would bring these back.
    pub fn with_model(mut self, model: Model) -> Result<Self> {
        let id = self.task.spec().id;
        let kind = KINDS.iter().find(|k| k.keywords.task == id).ok_or_else(|| no_task(id))?;
        self.setup.model = Arc::new(model);
        self.task = (kind.make)(&self.setup)?;
        Ok(self)
    }

    /// What of the options has no effect, and why: mechanisms of a sand.toml that robots do not feel.
    pub fn warnings(&self) -> Vec<String> {
        self.setup.model.scene.mechanisms.unfelt_by_walkers()
    }

    /// The keywords that this task takes, with the values they have here.
    pub fn keywords(&self) -> Vec<Keyword> {
        // Plain data: serialising it cannot fail, and a missing value would only be shown as null.
        let values = serde_json::to_value(&self.setup.options).unwrap_or_default();
        let own = OPTION_HELP.iter().filter(|(name, _)| self.setup.keywords().has(name));
        let keyword = |(name, summary): &(&'static str, &'static str)| Keyword {
            name,
            summary,
            value: values[*name].clone(),
            at_reset: ResetOptions::NAMES.contains(name),
        };
        own.map(keyword).collect()
    }

    /// Memory that one environment takes [bytes], roughly: rows twice (final observations), its episode, its robot.
    pub fn bytes_per_env(&self) -> usize {
        let spec = self.task.spec();
        let rows = 4 * (2 * spec.observation.len() + spec.info.len() + spec.action.len());
        let ground = if self.setup.options.randomize.is_some() { GROUND_BYTES } else { 0 };
        rows + EPISODE_BYTES + ground + self.engine.robot_bytes()
    }
}
