//! What a task is, and which there are.

use super::control::Control;
use super::gait::HexapodGait;
use super::ground::{Change, Ground};
use super::legs::HexapodLegs;
use super::options::{OPTION_HELP, ResetOptions, TaskOptions};
use super::random::Random;
use super::rocks::{HexapodRocks, RockOptions};
use super::spec::Spec;
use super::stroke::{self, LegStroke, StrokeOptions};
use super::terrain::{HexapodTerrain, Randomize};
use crate::error::{Error, Result};
use crate::sim::engine::{Command, EngineKind};
use crate::sim::{Model, State};
use serde_json::Value;
use std::sync::Arc;

/// What an episode is about: drawn or chosen when it begins, and changed by [`Task::walked`] alone.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// Commanded forward speed [m/s].
    pub speed: f64,
    /// Commanded yaw speed [rad/s].
    pub turn: f64,
    /// The setup's model with what this episode drew, for tasks that draw some of it.
    pub model: Option<Arc<Model>>,
    /// Ground that changes along the way and remembers, for the task that has it.
    pub ground: Option<Ground>,
}

/// What one environment may have been told by a reset: its own options and the model they make.
#[derive(Clone)]
pub struct Setup {
    kind: &'static Kind,
    pub options: TaskOptions,
    pub model: Arc<Model>,
}

impl Setup {
    fn new(kind: &'static Kind, options: TaskOptions) -> Result<Self> {
        let model = Arc::new(options.model()?);
        Ok(Self { kind, options, model })
    }

    /// The same task with all of `options`.
    pub fn with(&self, options: TaskOptions) -> Result<Self> {
        Self::new(self.kind, options)
    }

    /// This setup with a reset's changes.
    pub fn changed(&self, reset: &ResetOptions) -> Result<Self> {
        reset.given().iter().try_for_each(|name| self.kind.check(name))?;
        self.with(self.options.changed(reset))
    }
}

/// One control step as a task judges it.
pub struct Transition<'a> {
    pub options: &'a TaskOptions,
    /// What the episode is simulated with.
    pub model: &'a Model,
    pub goal: &'a Goal,
    pub before: &'a State,
    pub after: &'a State,
    /// This step's action, in [-1, 1].
    pub action: &'a [f32],
    pub previous_action: &'a [f32],
    /// Duration [s].
    pub period: f64,
    /// The state went beyond what can be computed; `after` is the last sound one.
    pub diverged: bool,
}

/// A task: pure functions from states to rows, the same for every environment of a session.
pub trait Task: Send + Sync {
    fn spec(&self) -> &Spec;

    /// First state and goal of an episode.
    fn begin(&self, setup: &Setup, random: &mut Random) -> (State, Goal);

    /// What the servos do under `action`.
    fn command(&self, action: &[f32], state: &State, command: &mut Command);

    /// Takes note of where a step has led, after it was judged; says what the engine must be told.
    fn walked(&self, _setup: &Setup, _goal: &mut Goal, _state: &State) -> Change {
        Change::Nothing
    }

    /// Fills an observation row.
    fn observe(&self, goal: &Goal, state: &State, last_action: &[f32], row: &mut [f32]);

    /// Fills an info row (weighted reward terms first) and says whether the episode terminated.
    fn judge(&self, transition: &Transition, info: &mut [f32]) -> bool;
}

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
    id: &'static str,
    /// Keywords that it takes beyond [`COMMON`].
    keywords: &'static [&'static str],
    defaults: fn() -> TaskOptions,
    make: fn(&Setup) -> Result<Arc<dyn Task>>,
}

/// Keywords of every task.
const COMMON: [&str; 3] = ["law", "dt", "max_episode_steps"];

/// Keywords of every robot that walks, beyond [`COMMON`].
macro_rules! walking {
    ($($own:literal),*) => {
        &["robot", "engine", "torque_limit", "command", "turn", "angle_noise", "weights", "leg", "medium", "sand",
          "slope_deg", "payload", $($own),*]
    };
}

const KINDS: [Kind; 5] = [
    Kind {
        id: HexapodGait::ID,
        keywords: walking!("control"),
        defaults: || TaskOptions { control: Some(Control::HipSpeed), ..Default::default() },
        make: |setup| Ok(Arc::new(HexapodGait::new(setup)?)),
    },
    Kind {
        id: HexapodLegs::ID,
        keywords: walking!(),
        defaults: || TaskOptions { robot: "xplorer18".into(), leg: "flat".into(), ..Default::default() },
        make: |setup| Ok(Arc::new(HexapodLegs::new(setup)?)),
    },
    Kind {
        id: HexapodRocks::ID,
        keywords: walking!("control", "rocks"),
        defaults: || TaskOptions {
            engine: EngineKind::Rapier,
            control: Some(Control::HipSpeed),
            rocks: Some(RockOptions::default()),
            ..Default::default()
        },
        make: |setup| Ok(Arc::new(HexapodRocks::new(setup)?)),
    },
    Kind {
        id: HexapodTerrain::ID,
        keywords: walking!("control", "randomize", "difficulty"),
        defaults: || TaskOptions {
            control: Some(Control::HipSpeed),
            randomize: Some(Randomize::default()),
            difficulty: Some(1.0),
            ..Default::default()
        },
        make: |setup| Ok(Arc::new(HexapodTerrain::new(setup)?)),
    },
    Kind {
        id: LegStroke::ID,
        keywords: &["angle_noise", "medium", "sand", "stroke"],
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
];

impl Kind {
    fn has(&self, keyword: &str) -> bool {
        COMMON.contains(&keyword) || self.keywords.contains(&keyword)
    }

    /// Refuses a keyword that the task does not take.
    fn check(&self, keyword: &str) -> Result<()> {
        if self.has(keyword) {
            return Ok(());
        }
        let others: Vec<_> = KINDS.iter().filter(|k| k.has(keyword)).map(|k| k.id).collect();
        if others.is_empty() {
            let known: Vec<_> = OPTION_HELP.iter().map(|(name, _)| *name).filter(|name| self.has(name)).collect();
            return Err(Error::unknown("option", keyword, &known));
        }
        Err(Error::invalid(keyword, format!("{} has no such option; {} has", self.id, others.join(", "))))
    }
}

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
pub const TASK_IDS: [&str; KINDS.len()] = {
    let mut ids = [""; KINDS.len()];
    let mut i = 0;
    while i < ids.len() {
        ids[i] = KINDS[i].id;
        i += 1;
    }
    ids
};

impl Blueprint {
    /// Task `id` with the keywords in `options` (a JSON object; null for defaults).
    pub fn new(id: &str, options: Value) -> Result<Self> {
        let kind = KINDS.iter().find(|k| k.id == id).ok_or_else(|| Error::unknown("task", id, &TASK_IDS))?;
        let options = (kind.defaults)().with(options, |name| kind.check(name))?;
        let engine = options.engine;
        if engine == EngineKind::Carriage && kind.has("engine") {
            return Err(Error::unknown("engine", engine.name(), &EngineKind::ALL.map(EngineKind::name)));
        }
        let setup = Setup::new(kind, options)?;
        let task = (kind.make)(&setup)?;
        let period = 1.0 / task.spec().control_rate;
        let (dt, steps) = (setup.options.dt, period / setup.options.dt);
        if (steps - steps.round()).abs() > 1e-6 * steps {
            return Err(Error::invalid("dt", format!("{dt} does not divide the control period {period} s")));
        }
        Ok(Self { task, engine, setup })
    }

    /// The keywords that this task takes, with the values they have here.
    pub fn keywords(&self) -> Vec<Keyword> {
        // Plain data: serialising it cannot fail, and a missing value would only be shown as null.
        let values = serde_json::to_value(&self.setup.options).unwrap_or_default();
        let own = OPTION_HELP.iter().filter(|(name, _)| self.setup.kind.has(name));
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
