//! `sandgait train`

use super::Bar;
use sandgait::env::Task;
use sandgait::env::gait::HexapodGait;
use sandgait::evaluate::{FIRST_SEED, Request as Evaluation, table};
use sandgait::progress::Progress;
use sandgait::train::{Outcome, Request, entry};
use sandgait::{Error, Result, parallel};
use serde_json::{Map, Value};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Learn a gait: PPO beside the environments, without Python.
///
/// Settings are those of stable-baselines3's PPO and of examples/hyperparameters/ppo.yml; without a file the program's own,
/// src/train/ppo_fast.yml. The directory gets policy.onnx (for evaluate, rollout_policy and export),
/// policy.safetensors, settings.json, curve.csv, curve.png, evaluation.txt, walk.rec (for replay), walk.png, checkpoints/ and
/// tensorboard/. docs/learning.md says more.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait train                                     (HexapodGait, a minute)
  sandgait train --task HexapodLegs --seed 1 --out runs/legs
  sandgait train --option leg=C --option slope_deg=5 --set gamma=0.97 --seconds 30
  sandgait train --resume --seconds 120              (go on from the last checkpoint in the directory)
  sandgait train --timesteps 2000000                 (the same to the bit each time: no clock ends it)")]
pub struct Train {
    /// Task's name or id
    #[arg(long, value_name = "TASK", default_value = HexapodGait::ID)]
    task: String,
    /// File of settings in the manner of rl-zoo3, one entry a task
    #[arg(long, value_name = "FILE.yml")]
    hyperparameters: Option<PathBuf>,
    /// Another value of a setting
    #[arg(long, value_name = "NAME=VALUE", allow_hyphen_values = true)]
    set: Vec<String>,
    /// Option of the task
    #[arg(long, value_name = "NAME=VALUE", allow_hyphen_values = true)]
    option: Vec<String>,
    /// Of the policy, its exploration and the environments
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// The training ends after this time, whatever the settings say; a resumed one counts the time before
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// The training ends after this many steps; without --seconds only then
    #[arg(long, value_name = "N")]
    timesteps: Option<u64>,
    /// Directory for the results [default: runs/TASK-fast]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Go on from the last checkpoint in the directory
    #[arg(long)]
    resume: bool,
    /// Steps between two checkpoints
    #[arg(long, value_name = "STEPS", default_value_t = 1_000_000)]
    checkpoint_every: u64,
    /// Threads; 0: one a processor
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
}

/// Most threads, and largest seed: our choice of guards.
const MOST_THREADS: usize = 1024;
const MOST_SEED: u64 = (1 << 23) - 1;

impl Train {
    pub fn run(self) -> Result<String> {
        let task = entry::task_id(&self.task);
        let request = self.request(task)?;
        super::warn_of_unfelt_option(&request.options);
        let outcome = request.run(&Interruptible { bar: Bar::new(), stop: interrupted() })?;
        let text = report(&request, &outcome);
        let path = request.out.join("evaluation.txt");
        std::fs::write(&path, &text).map_err(|e| Error::file(&path, e))?;
        let out = request.out.display();
        Ok(format!(
            "{text}\nEverything is in {out}/. To see the walk: sandgait replay {out}/walk.rec --html walk.html\n"
        ))
    }

    fn request(self, task: String) -> Result<Request> {
        let mut changes = self.set;
        if let Some(steps) = self.timesteps {
            changes.push(format!("n_timesteps={steps}"));
            changes.extend(self.seconds.is_none().then(|| "seconds=null".to_owned()));
        }
        changes.extend(self.seconds.map(|seconds| format!("seconds={seconds}")));
        let settings = entry::settings(self.hyperparameters.as_deref(), &task, &changes)?;
        let mut options = Map::new();
        for option in &self.option {
            let (name, value) = entry::pair("--option", option)?;
            options.insert(name, value);
        }
        let mut options = Value::Object(options);
        super::robot::read_option(&mut options)?;
        let within = |name: &str, value: u64, most: u64| match value <= most {
            true => Ok(()),
            false => Err(Error::invalid(name, format!("{value} is outside [0, {most}]"))),
        };
        within("--threads", self.threads as u64, MOST_THREADS as u64)?;
        within("--seed", self.seed, MOST_SEED)?;
        let name = task.trim_start_matches("sandgait/").rsplit_once("-v").map_or(task.as_str(), |(name, _)| name);
        Ok(Request {
            out: self.out.unwrap_or_else(|| PathBuf::from("runs").join(format!("{name}-fast"))),
            task,
            options,
            settings,
            seed: self.seed,
            threads: if self.threads == 0 { parallel::processors() } else { self.threads },
            resume: self.resume,
            checkpoint_every: self.checkpoint_every.max(1),
        })
    }
}

fn report(request: &Request, outcome: &Outcome) -> String {
    let learnt = &outcome.learnt;
    let rate = learnt.steps as f64 / learnt.seconds / 1e3;
    let share = outcome.last.map_or(String::new(), |r| format!(", {:.0} % of it for rollouts", 100.0 * r.simulation));
    let mut text = format!(
        "{}, seed {}: {:.2} M steps in {:.1} s ({rate:.0} k a second{share})\n",
        request.task,
        request.seed,
        learnt.steps as f64 / 1e6,
        learnt.seconds,
    );
    if let Some(row) = &outcome.score {
        let rows = [row.clone()];
        let last = FIRST_SEED + Evaluation::SEEDS as u64 - 1;
        let (cells, notes) = (table::cells(&rows), table::notes(&rows));
        text += &format!(
            "\nwithout noise, unseen seeds {FIRST_SEED} to {last}:\n\n{}\n{}\n",
            super::table(&cells),
            notes.join("\n")
        );
    }
    text
}

/// Is set by the first Ctrl-C; the second one ends the process.
fn interrupted() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let heard = stop.clone();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        // Where signals cannot be heard, Ctrl-C ends the process at once, as ever.
        let Ok(runtime) = runtime else { return };
        runtime.block_on(async {
            while tokio::signal::ctrl_c().await.is_ok() {
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
}
