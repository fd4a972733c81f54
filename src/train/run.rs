//! A training with all its files: `settings.json`, `curve.csv`, checkpoints, TensorBoard's events and, at the end,
//! the policy, its score over unseen seeds, the learning curve and a film.

use super::curve::{CurvePoint, LearningCurve, OpenPoint};
use super::events::EventFile;
use super::film::Film;
use super::outlook::{OUTLOOK, outlook};
use super::plan::{Observer, TrainingPlan, TrainingState, UpdateReport};
use super::remote::{Pause, RemoteEnvironments};
use super::settings::Hyperparameters;
use super::spec::{ExternalSpaces, TrainingSpec};
use super::teacher::{self, Suited};
use super::{checkpoint, describe, export, golden};
use crate::env::Task;
use crate::env::legged::LeggedVelocity;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::evaluate::commands::{CommandStudy, CommandTracking};
use crate::evaluate::{self, Evaluation, EvaluationRow, PolicySource, episode};
use crate::files::{self, Lock};
use crate::policy::Network;
use crate::progress::{PartialProgress, Progress};
use serde::Serialize;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The training's share of the progress; the rest is for the evaluation, which is shorter: our choice.
const TRAINING: f64 = 0.97;

/// File name of the policy.
const POLICY: &str = "policy.onnx";

/// Interval of checks whether the training was stopped: our choice, well below the 100 ms that a person notices.
const PATIENCE: Duration = Duration::from_millis(20);

/// Makes remote environments from the training's plan and the options of its request.
pub type Connect = dyn Fn(&TrainingPlan, &Value, Pause) -> Result<Box<dyn RemoteEnvironments>> + Send + Sync;

/// A request for a training.
pub struct TrainingRequest {
    /// The task's id, or the name of another program's environments.
    pub task: String,
    /// Keywords of the task; without them the settings' `env_kwargs` apply. For another program's environments these
    /// are all facts that identify them besides their name.
    pub options: Value,
    /// The spaces of another program's environments, which `connect` makes; None: the environments are those of a task.
    pub external: Option<ExternalSpaces>,
    pub settings: Hyperparameters,
    pub seed: u64,
    pub threads: usize,
    /// Folder for the results.
    pub out: PathBuf,
    /// Continue from the last checkpoint in `out`?
    pub resume: bool,
    /// Checkpoint of another training, whose networks and normalization this training starts with. It excludes `resume`.
    pub start_from: Option<PathBuf>,
    /// Steps between two checkpoints.
    pub checkpoint_every: u64,
    /// Makes the environments on a server or in another program; None: they are in this process.
    pub connect: Option<Box<Connect>>,
}

/// Results of a training.
pub struct TrainingOutcome {
    pub learnt: TrainingState,
    pub last: Option<UpdateReport>,
    /// The learning curve.
    pub curve: Vec<CurvePoint>,
    /// One sentence for each way in which the training differs from one that simply goes on with the newest checkpoint:
    /// checkpoints that were skipped, and the reason for new episodes.
    pub notices: Vec<String>,
    /// The policy without noise over 100 unseen seeds; None for LegStroke and for other programs' environments.
    pub score: Option<PolicyScore>,
}

/// The score of a policy without noise.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PolicyScore {
    /// For tasks in which hexapods walk.
    Walking(EvaluationRow),
    /// For LeggedVelocity.
    Commands(CommandTracking),
}

impl PolicyScore {
    /// Mean return of an episode, if the score has one.
    fn mean_return(&self) -> Option<f64> {
        match self {
            Self::Walking(row) => Some(row.figures.total_reward.mean),
            Self::Commands(_) => None,
        }
    }
}

impl TrainingRequest {
    /// Trains, and writes all files into the folder. A training that is stopped leaves a checkpoint.
    pub fn run(&self, progress: &dyn Progress) -> Result<TrainingOutcome> {
        let mut options = self.options()?;
        let suited = self.suit(&mut options)?;
        let own_time = self.settings.biped_seconds.filter(|_| suited.on_two);
        let plan = self.plan(&options, own_time)?;
        let taught = plan.teacher.as_ref().map(|own| own.note(self.settings.gait_prior, &suited));
        suited.notes().iter().chain(&taught).for_each(|note| progress.note(note));
        plan.notes.iter().for_each(|note| progress.note(note));
        if let Some(seconds) = own_time {
            let minutes = seconds / 60.0;
            progress.note(&format!(
                "it learns for {minutes:.0} min, because the robot has two legs (--seconds sets another time)"
            ));
        }
        let lock = self.out.is_dir().then(|| self.lock()).transpose()?;
        let checkpoint::Checkpoint { learnt, open, mut notices } = self.begin(&plan)?;
        let mut remote = match &self.connect {
            Some(connect) => {
                let pause = &mut || progress.report(0.0, "connecting");
                Some(connect(&plan, &options, pause)?)
            }
            None => None,
        };
        let folder = checkpoint::folder(&self.out);
        std::fs::create_dir_all(&folder).map_err(|e| Error::unwritten(&folder, &e))?;
        // If the folder was missing, another process may have made it since then, and have begun a training in it.
        let _lock = lock.map_or_else(|| self.lock(), Ok)?;
        self.check_unused()?;
        let about = json!({
            "task": self.task,
            "seed": self.seed,
            "options": options,
            "version": env!("CARGO_PKG_VERSION"),
            "instruction_set": plan.networks.isa.name(),
            "hyperparameters": plan.settings.json(),
        });
        self.write("settings.json", format!("{about:#}\n").as_bytes())?;
        let until = self.resume.then_some(learnt.steps);
        let part = PartialProgress::new(progress, [0.0, TRAINING]);
        let mut diary = TrainingFiles {
            plan: &plan,
            curve: LearningCurve::new(&self.out.join("curve.csv"), until, open, self.settings.n_envs)?,
            events: EventFile::new(&self.out.join("tensorboard"))?,
            last: None,
            left_out: None,
            saved: learnt.steps,
            seconds: learnt.seconds,
            newest: learnt.clone(),
            request: self,
            progress: &part,
            told: (0.0, "the training".into()),
            asked: Instant::now(),
            updates: 0,
        };
        notices.extend(diary.curve.notice.take());
        let learnt = match plan.run(learnt, remote.as_deref_mut(), &mut diary) {
            Ok(learnt) => learnt,
            Err(error) => return Err(diary.abandon(error)),
        };
        notices.extend(remote.iter().flat_map(|remote| remote.notices()));
        drop(remote);
        diary.save()?;
        notices.extend(diary.left_out.take());
        let score = self.keep(&plan, &learnt, options, &PartialProgress::new(progress, [TRAINING, 1.0]));
        let score = score.map_err(|error| self.after_training(error))?;
        diary.curve.draw(&self.out.join("curve.svg"), &self.task, score.as_ref().and_then(PolicyScore::mean_return))?;
        let mut about = about;
        about["steps"] = learnt.steps.into();
        about["seconds"] = learnt.seconds.into();
        about["score"] = json!(score);
        self.write("settings.json", format!("{about:#}\n").as_bytes())?;
        Ok(TrainingOutcome { learnt, last: diary.last, curve: diary.curve.points, notices, score })
    }

    /// `own_time`: a time that suits the robot, in place of that of the settings [s].
    fn plan(&self, options: &Value, own_time: Option<f64>) -> Result<TrainingPlan> {
        let settings = Hyperparameters { seconds: own_time.or(self.settings.seconds), ..self.settings.clone() };
        match &self.external {
            Some(_) if !settings.env_kwargs.is_empty() => {
                Err(Error::invalid("env_kwargs", "the environments are made already"))
            }
            Some(spaces) => {
                let options = options.as_object().cloned().unwrap_or_default();
                let spec = TrainingSpec::external(&self.task, options, spaces);
                TrainingPlan::external(spec, settings, [self.seed, self.threads as u64])
            }
            None => TrainingPlan::new(Blueprint::new(&self.task, options.clone())?, settings, self.seed, self.threads),
        }
    }

    /// Sets options that suit a plain gait, where the policy begins with one.
    fn suit(&self, options: &mut Value) -> Result<Suited> {
        if self.external.is_some() || self.task != LeggedVelocity::ID || self.settings.gait_prior == 0 {
            return Ok(Suited::default());
        }
        // A training that goes on keeps its options, also on another processor, whose simulation rounds differently.
        let kept = self.resume.then(|| std::fs::read(self.out.join("settings.json")).ok()).flatten();
        let kept: Value = kept.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
        teacher::suit(options, &kept["options"])
    }

    fn lock(&self) -> Result<Lock> {
        Lock::new(&self.out, "choose another one with --out, or wait until it has ended")
    }

    /// Refuses to begin where another training has left its results.
    fn check_unused(&self) -> Result<()> {
        if self.resume || !checkpoint::is_used(&self.out) {
            return Ok(());
        }
        let reason = "it has the results of another training: go on with that one with --resume, choose another folder \
                      with --out, or delete this one";
        Err(Error::file(&self.out, reason))
    }

    /// The state with which the training begins, or goes on.
    fn begin(&self, plan: &TrainingPlan) -> Result<checkpoint::Checkpoint> {
        let away = self.connect.is_some();
        self.check_unused()?;
        let learnt = match (self.resume, &self.start_from) {
            (true, Some(_)) => {
                return Err(Error::invalid("start_from", "resume goes on from the training's own checkpoint"));
            }
            (true, None) => return checkpoint::newest(&self.out, plan, away),
            (false, Some(other)) => plan.begin_from(&checkpoint::load(other, plan, away)?.learnt),
            (false, None) => plan.begin(),
        };
        Ok(checkpoint::Checkpoint { learnt, open: OpenPoint::default(), notices: Vec::new() })
    }

    fn options(&self) -> Result<Value> {
        let mut options = self.settings.env_kwargs.clone();
        match &self.options {
            Value::Null => (),
            Value::Object(given) => options.extend(given.clone()),
            _ => return Err(Error::invalid("options", "not an object of keywords")),
        }
        Ok(Value::Object(options))
    }

    /// Writes the policy. If the environments are of a task, evaluates it over unseen seeds and records a film.
    fn keep(
        &self,
        plan: &TrainingPlan,
        learnt: &TrainingState,
        options: Value,
        progress: &dyn Progress,
    ) -> Result<Option<PolicyScore>> {
        let onnx = self.keep_policy(plan, learnt)?;
        let Some(blueprint) = &plan.spec.blueprint else { return Ok(None) };
        let spec = blueprint.task.spec();
        let network = Network::new(&onnx, spec)?;
        let mut shown = options.clone();
        if spec.id == LeggedVelocity::ID {
            // Shows the ground of the task itself, not the ground of the curriculum's first level.
            shown["curriculum"] = Value::Null;
        }
        let shown = Blueprint::new(&self.task, shown)?;
        Film::of(&self.out).shoot(&shown, &network, evaluate::FIRST_SEED)?;
        if let Some(trace) = golden::golden(&self.task, &options, &onnx)? {
            self.write("golden.csv", trace.as_bytes())?;
        }
        let policy = PolicySource::Network { name: "policy.onnx".into(), bytes: onnx };
        if spec.id == LeggedVelocity::ID {
            return CommandStudy::new(&policy, &options)?.run(progress).map(PolicyScore::Commands).map(Some);
        }
        if episode::Columns::of(spec).is_err() {
            return Ok(None);
        }
        let request = evaluate::EvaluationRequest {
            policy,
            task: self.task.clone(),
            options,
            seeds: evaluate::EvaluationRequest::SEEDS,
            media: Vec::new(),
            slopes: Vec::new(),
        };
        let rows = Evaluation::new(&request)?.run(progress)?;
        Ok(rows.into_iter().next().map(PolicyScore::Walking))
    }

    /// The error if the work after the training is stopped: the policy is already in the folder.
    fn after_training(&self, error: Error) -> Error {
        match error {
            Error::Cancelled(why) => {
                let policy = self.out.join(POLICY);
                Error::Cancelled(format!("{why}; the training is over, and its policy is kept in {}", policy.display()))
            }
            other => other,
        }
    }

    /// Writes the policy as ONNX, its description and its weights; returns the ONNX file's bytes.
    fn keep_policy(&self, plan: &TrainingPlan, learnt: &TrainingState) -> Result<Vec<u8>> {
        let onnx = export::onnx(plan, learnt);
        self.write(POLICY, &onnx)?;
        self.write("policy.json", format!("{:#}\n", describe::policy(plan, &onnx)).as_bytes())?;
        let policy = TrainingState { environments: None, ..learnt.clone() };
        checkpoint::save(&self.out.join("policy.safetensors"), plan, &policy, &OpenPoint::default())?;
        Ok(onnx)
    }

    fn write(&self, name: &str, content: &[u8]) -> Result<()> {
        files::write(&self.out.join(name), content)
    }
}

/// Writes files during a training.
struct TrainingFiles<'a> {
    plan: &'a TrainingPlan,
    request: &'a TrainingRequest,
    curve: LearningCurve,
    events: EventFile,
    last: Option<UpdateReport>,
    /// What the last checkpoint lacks.
    left_out: Option<String>,
    /// Steps at the last checkpoint.
    saved: u64,
    /// Seconds at the last update.
    seconds: f64,
    newest: TrainingState,
    progress: &'a dyn Progress,
    /// The last progress report, and when we last asked whether to stop.
    told: (f64, String),
    asked: Instant,
    /// Number of updates in this process.
    updates: u32,
}

impl Observer for TrainingFiles<'_> {
    fn pause(&mut self) -> Result<()> {
        if self.asked.elapsed() < PATIENCE {
            return Ok(());
        }
        self.asked = Instant::now();
        self.progress.report(self.told.0, &self.told.1)
    }

    fn update(&mut self, learnt: &TrainingState, report: &UpdateReport) -> Result<()> {
        self.newest.clone_from(learnt);
        self.curve.note(report)?;
        let samples = (self.request.settings.n_envs * self.request.settings.n_steps) as f64;
        let rate = samples / (report.seconds - self.seconds);
        self.seconds = report.seconds;
        self.log(report, rate)?;
        if report.steps - self.saved >= self.request.checkpoint_every {
            self.save()?;
        }
        self.last = Some(report.clone());
        self.updates += 1;
        if let (Some(level), OUTLOOK) = (report.level, self.updates) {
            self.progress.note(&outlook(level, report.steps, rate));
        }
        let reached = self.curve.points.last().map_or(String::new(), |p| format!(", return {:.0}", p.mean_return));
        let level = report.level.map_or(String::new(), |level| format!(", level {level:.2}"));
        let (millions, thousands) = (report.steps as f64 / 1e6, rate / 1e3);
        let stage = format!("the training: {millions:.2} M steps{reached}{level}, {thousands:.0} k a second");
        self.told = (report.done, stage);
        self.asked = Instant::now();
        self.progress.report(self.told.0, &self.told.1)
    }
}

impl TrainingFiles<'_> {
    fn log(&mut self, report: &UpdateReport, rate: f64) -> Result<()> {
        let scalars = [
            ("rollout/ep_rew_mean", report.mean_return),
            ("train/learning_rate", report.learning_rate),
            ("train/policy_gradient_loss", report.policy_loss),
            ("train/value_loss", report.value_loss),
            ("train/entropy_loss", -report.entropy),
            ("train/approx_kl", report.kl),
            ("train/clip_fraction", report.clip_fraction),
            ("train/explained_variance", report.explained_variance),
            ("train/std", report.deviation),
            ("time/fps", rate),
            ("time/simulation_share", report.simulation),
        ];
        self.events.scalars(report.steps, &scalars)?;
        let tag = |name: &str| format!("reward/{}", name.strip_prefix("reward_").unwrap_or(name));
        let named = report.terms.iter().map(|(name, mean)| (tag(name), *mean));
        let level = report.level.map(|level| ("rollout/level".to_owned(), level));
        let more: Vec<_> = named.chain(level).collect();
        let more: Vec<(&str, f64)> = more.iter().map(|(name, value)| (&name[..], *value)).collect();
        self.events.scalars(report.steps, &more)
    }

    fn save(&mut self) -> Result<PathBuf> {
        let path = checkpoint::path(&self.request.out, self.newest.steps);
        // The curve on the disk must have all points before the checkpoint.
        self.curve.sync()?;
        self.left_out = checkpoint::save(&path, self.plan, &self.newest, &self.curve.open)?;
        self.saved = self.newest.steps;
        Ok(path)
    }

    /// Writes the policy and a checkpoint of the last valid state. Returns the error with a note on these files.
    fn abandon(mut self, error: Error) -> Error {
        let steps = self.newest.steps;
        let kept = |policy: &Path| {
            format!("; the policy of {steps} steps is kept in {}, go on with --resume", policy.display())
        };
        let note = match steps {
            0 => "; no policy was learnt yet".to_owned(),
            _ => match self.save().and_then(|_| self.request.keep_policy(self.plan, &self.newest)) {
                Ok(_) => kept(&self.request.out.join(POLICY)),
                Err(e) => format!("; neither policy nor checkpoint: {e}"),
            },
        };
        error.with_note(&note)
    }
}
