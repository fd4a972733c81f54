//! `sandgait train`

use super::Bar;
use super::OptionArgs;
use super::signals::StopSignals;
use sandgait::client::ServerAddress;
use sandgait::client::training::TrainingSession;
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::env::registry::task_id;
use sandgait::evaluate::{EvaluationRequest, FIRST_SEED, commands, table};
use sandgait::progress::Progress;
use sandgait::train::remote::RemoteEnvironments;
use sandgait::train::{Connect, ExternalSpaces, Hyperparameters, PolicyScore, TrainingOutcome, TrainingRequest, entry};
use sandgait::{Error, Result, files, parallel};
use serde_json::Value;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Learn a gait by PPO in the same process as the environments, without Python.
///
/// Settings have the names of stable-baselines3's PPO and of examples/hyperparameters/ppo.yml. Without a file those of
/// src/train/ppo_fast.yml are used. The command writes into the directory: policy.onnx (for evaluate, rollout_policy
/// and export), policy.safetensors, settings.json, curve.csv, curve.svg, evaluation.txt, walk.html, walk.png (moving), walk.rec
/// (for replay), checkpoints/ and tensorboard/. docs/learning.md explains them.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait train                                     (HexapodGait, a minute)
  sandgait train --task HexapodLegs --seed 1 --out runs/legs
  sandgait train --resume --seconds 120              (continues from the last checkpoint in the directory)
  sandgait train --option leg=C --option slope_deg=5 --set gamma=0.97 --seconds 30 --out runs/slope
  sandgait train --option slope_deg=10 --start-from runs/HexapodGait-fast/policy.safetensors --out runs/steep
  sandgait train --timesteps 2000000 --out runs/two  (the same bits each time, because it has no limit of time)
  sandgait train --address sand.lab:50051 --ca ca.pem --token-file token    (environments on a server)")]
pub struct TrainArgs {
    #[command(flatten)]
    training: TrainingArgs,
    /// Replace the value of a setting
    #[arg(long, value_name = "NAME=VALUE", allow_hyphen_values = true)]
    set: Vec<String>,
    #[command(flatten)]
    options: OptionArgs,
    /// Simulate on the server at host:port or unix:/path; learning stays in this process
    #[arg(long, value_name = "ADDRESS")]
    address: Option<String>,
    /// The server's token
    #[arg(long, value_name = "FILE", requires = "address")]
    token_file: Option<PathBuf>,
    /// Encrypt the connection, and trust certificates of this authority (PEM)
    #[arg(long, value_name = "FILE", requires = "address")]
    ca: Option<PathBuf>,
}

/// What the command line and Python state in the same way.
#[derive(clap::Args)]
pub struct TrainingArgs {
    /// Name or id of the task
    #[arg(long, value_name = "TASK", default_value = HexapodGait::ID)]
    pub task: String,
    /// File of settings in the format of rl-zoo3, one entry for each task
    #[arg(long, value_name = "FILE.yml")]
    pub hyperparameters: Option<PathBuf>,
    /// Seed of the policy, its exploration and the environments
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = super::whole::<u64>(0..=MOST_SEED))]
    pub seed: u64,
    /// The training ends after this time [s], instead of that in the settings; the time before a resumption counts
    #[arg(long, value_name = "S")]
    pub seconds: Option<f64>,
    /// The training ends after this number of steps; without --seconds it has no limit of time
    #[arg(long, value_name = "N", value_parser = super::whole::<u64>(1..=MOST_STEPS))]
    pub timesteps: Option<u64>,
    /// Directory for the results [default: runs/TASK-fast]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Continue from the last checkpoint in the directory
    #[arg(long)]
    pub resume: bool,
    /// Start with the networks of another training: its policy.safetensors or a checkpoint. Task, observation and
    /// actions must be the same
    #[arg(long, value_name = "FILE.safetensors", conflicts_with = "resume")]
    pub start_from: Option<PathBuf>,
    /// Number of steps between two checkpoints
    #[arg(long, value_name = "STEPS", default_value_t = 1_000_000, value_parser = super::whole::<u64>(1..=MOST_STEPS))]
    pub checkpoint_every: u64,
    /// Number of simulating threads; 0: one for each processor
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = super::whole::<usize>(0..=super::MOST_THREADS))]
    pub threads: usize,
}

/// Largest number of steps: that of `n_timesteps` in the settings.
const MOST_STEPS: u64 = 1_000_000_000_000;
/// Largest seed of a training: our choice, so that the seeds of its episodes cannot overflow 64 bits.
const MOST_SEED: u64 = (1 << 23) - 1;

impl TrainArgs {
    pub fn run(self) -> Result<String> {
        let request = self.request()?;
        super::warn_of_unfelt_option(&request.options);
        let (_, text) = learn(&request, &Interruptible { bar: Bar::new(), stop: interrupted() })?;
        let out = request.out.display();
        super::progress::next_step(Some(format!("to steer it: sandgait play {out}")));
        Ok(format!(
            "{text}\nEverything is in {out}/. The walk: {out}/walk.html in a browser, or the moving picture {out}/walk.png\n"
        ))
    }

    fn request(self) -> Result<TrainingRequest> {
        let changes = entry::pairs("--set", &self.set)?;
        let options = Value::Object(self.options.read(super::read_files)?);
        let place = self.address.map(|address| place(address, self.token_file.as_deref(), self.ca.as_deref()));
        self.training.request(changes, options, place.transpose()?)
    }
}

/// The server's address. A token is sent only over TLS, over a Unix socket or to this machine.
fn place(address: String, token: Option<&Path>, ca: Option<&Path>) -> Result<ServerAddress> {
    let port = address.rsplit_once(':').is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    if !port && !address.starts_with("unix:") {
        return Err(Error::invalid("--address", format!("{address:?} is neither host:port nor unix:/path")));
    }
    let read = |path: &Path| files::read(path, files::MOST_TEXT);
    let token = token.map(read).transpose()?.map(|token| String::from_utf8_lossy(&token).trim().to_owned());
    let ca = ca.map(read).transpose()?;
    let host = address.rsplit_once(':').map_or(address.as_str(), |(host, _)| host).trim_matches(['[', ']']);
    let local = host == "localhost" || host.parse().is_ok_and(|host: IpAddr| host.is_loopback());
    if token.is_some() && ca.is_none() && !local && !address.starts_with("unix:") {
        let reason = format!("it would be sent to {address} without encryption; add --ca");
        return Err(Error::invalid("--token-file", reason));
    }
    Ok(ServerAddress { tls: ca.is_some(), address, token, ca, identity: None })
}

impl TrainingArgs {
    /// Checks everything except what only the task and the server can check. `changes`: settings that replace those of
    /// the file; `options`: options of the task, as an object; `place`: the server that has the environments.
    pub fn request(
        self,
        mut changes: Vec<(String, Value)>,
        options: Value,
        place: Option<ServerAddress>,
    ) -> Result<TrainingRequest> {
        let task = task_id(&self.task);
        changes.extend(entry::ends(self.timesteps, self.seconds)?);
        let settings = entry::settings(self.hyperparameters.as_deref(), task, changes)?;
        let unchecked = unchecked(task.to_owned(), options, settings);
        self.checked(TrainingRequest { connect: place.map(connected), ..unchecked })
    }

    /// The same for another program's environments, which `connect` makes. `self.task` is their name, and `options` has
    /// what else identifies them.
    pub fn external(
        self,
        mut changes: Vec<(String, Value)>,
        options: Value,
        spaces: ExternalSpaces,
        envs: usize,
        connect: Box<Connect>,
    ) -> Result<TrainingRequest> {
        changes.extend(entry::ends(self.timesteps, self.seconds)?);
        let settings = entry::external(self.hyperparameters.as_deref(), &self.task, envs, changes)?;
        let request = unchecked(self.task.clone(), options, settings);
        self.checked(TrainingRequest { external: Some(spaces), connect: Some(connect), ..request })
    }

    /// Adds the arguments to a request.
    fn checked(self, request: TrainingRequest) -> Result<TrainingRequest> {
        // The command line has checked these already, but Python has not.
        let within = |name: &str, value: u64, range: std::ops::RangeInclusive<u64>| match range.contains(&value) {
            true => Ok(()),
            false => {
                let reason = format!("{value} is outside [{}, {}]", range.start(), range.end());
                Err(Error::invalid(name, reason))
            }
        };
        within("threads", self.threads as u64, 0..=super::MOST_THREADS)?;
        within("seed", self.seed, 0..=MOST_SEED)?;
        within("checkpoint_every", self.checkpoint_every, 1..=MOST_STEPS)?;
        let task = &request.task;
        let name = task.trim_start_matches("sandgait/").rsplit_once("-v").map_or(task.as_str(), |(name, _)| name);
        let name = name.replace(|c: char| !c.is_alphanumeric() && c != '_', "-");
        Ok(TrainingRequest {
            out: self.out.unwrap_or_else(|| PathBuf::from("runs").join(format!("{name}-fast"))),
            seed: self.seed,
            threads: if self.threads == 0 { parallel::processors() } else { self.threads },
            resume: self.resume,
            start_from: self.start_from,
            checkpoint_every: self.checkpoint_every,
            ..request
        })
    }
}

/// A request to which the arguments are not added yet.
fn unchecked(task: String, options: Value, settings: Hyperparameters) -> TrainingRequest {
    TrainingRequest {
        task,
        options,
        external: None,
        settings,
        seed: 0,
        threads: 1,
        out: PathBuf::new(),
        resume: false,
        start_from: None,
        checkpoint_every: 1,
        connect: None,
    }
}

fn connected(place: ServerAddress) -> Box<Connect> {
    Box::new(move |plan, options, pause| {
        let session = TrainingSession::new(place.clone(), plan.spec.task()?, options, plan.settings.n_envs, pause)?;
        Ok(Box::new(session) as Box<dyn RemoteEnvironments>)
    })
}

/// Trains, and writes all files; returns the results, also as text.
pub fn learn(request: &TrainingRequest, progress: &dyn Progress) -> Result<(TrainingOutcome, String)> {
    let robot = request.options.get("robot").and_then(Value::as_str).filter(|_| request.external.is_none());
    if let (Some(robot), None) = (robot, request.options.get("dt")) {
        super::warn(super::robot_check::finer_step(robot)?.as_slice(), "");
    }
    let outcome = request.run(progress)?;
    let text = report(request, &outcome);
    let path = request.out.join("evaluation.txt");
    files::write(&path, text.as_bytes())?;
    Ok((outcome, text))
}

fn report(request: &TrainingRequest, outcome: &TrainingOutcome) -> String {
    let learnt = &outcome.learnt;
    let rate = learnt.steps as f64 / learnt.seconds / 1e3;
    let share =
        outcome.last.as_ref().map_or(String::new(), |r| format!(", {:.0} % of it for rollouts", 100.0 * r.simulation));
    let mut text = format!(
        "{}, seed {}: {:.2} M steps in {:.1} s ({rate:.0} k a second{share})\n",
        request.task,
        request.seed,
        learnt.steps as f64 / 1e6,
        learnt.seconds,
    );
    for notice in &outcome.notices {
        text += &format!("{notice}\n");
    }
    match &outcome.score {
        Some(PolicyScore::Walking(row)) => {
            let rows = [row.clone()];
            let last = FIRST_SEED + EvaluationRequest::SEEDS as u64 - 1;
            let (cells, notes) = (table::cells(&rows), table::notes(&rows));
            let head = format!("without noise, unseen seeds {FIRST_SEED} to {last}:");
            text +=
                &format!("\n{head}\n\n{}\n{}\n", sandgait::study::layout::narrow_table(&cells, 2), notes.join("\n"));
        }
        Some(PolicyScore::Commands(followed)) => {
            let (cells, summary) = (commands::cells(followed), commands::summary(followed));
            let level = outcome.last.as_ref().and_then(|report| report.level);
            let limit =
                sandgait::study::layout::wrapped(&commands::limit(followed, level), sandgait::study::layout::WIDTH)
                    .join("\n");
            let table = super::table(&cells);
            text += &format!("\nwithout noise and randomness, by command:\n\n{table}\n{summary}\n\n{limit}\n");
        }
        None => (),
    }
    text
}

/// The first Ctrl-C or SIGTERM sets this flag. The second one ends the process.
fn interrupted() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let heard = stop.clone();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        // If signals cannot be handled, Ctrl-C ends the process at once, as usual.
        let Ok(runtime) = runtime else { return };
        runtime.block_on(async {
            let Ok(mut signals) = StopSignals::new() else { return };
            loop {
                signals.next().await;
                if heard.swap(true, Ordering::Relaxed) {
                    std::process::exit(130);
                }
            }
        });
    });
    stop
}

struct Interruptible {
    bar: Bar,
    stop: Arc<AtomicBool>,
}

impl Progress for Interruptible {
    fn report(&self, done: f64, stage: &str) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Error::Cancelled("stopped".into()));
        }
        self.bar.report(done, stage)
    }

    fn note(&self, line: &str) {
        self.bar.note(line);
    }
}
